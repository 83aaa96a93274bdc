"""Runs a command in a network of its own, in which there is nothing but the loopback interface."""

import ctypes
import fcntl
import os
import socket
import struct
import sys

NEW_USER, NEW_NETWORK = 0x10000000, 0x40000000  # of unshare(2)
GET_FLAGS, SET_FLAGS, UP = 0x8913, 0x8914, 1  # of netdevice(7)
NOT_ALLOWED = 77

libc = ctypes.CDLL(None, use_errno=True)
if libc.unshare(NEW_NETWORK if os.geteuid() == 0 else NEW_USER | NEW_NETWORK):
    print(os.strerror(ctypes.get_errno()), file=sys.stderr)
    sys.exit(NOT_ALLOWED)
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
    request = fcntl.ioctl(any_socket, GET_FLAGS, struct.pack("16sH14x", b"lo", 0))
    fcntl.ioctl(any_socket, SET_FLAGS, struct.pack("16sH14x", b"lo", struct.unpack("16sH14x", request)[1] | UP))
os.execvp(sys.argv[1], sys.argv[1:])
