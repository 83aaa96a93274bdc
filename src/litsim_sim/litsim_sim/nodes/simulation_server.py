"""Node of `serve`: loads one scenario after the other for clients of ``simulation_interfaces``, each as a launch.

While a run is on, its bridge has the other services of that standard (:mod:`.simulation_services`).
"""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node

from litsim_sim.core.errors import InputError, not_installed, printable, reason, shown
from litsim_sim.launch.nodes import find_executable
from litsim_sim.nodes.simulation_services import Refused, answering, msg, service_name, srv, world_of
from litsim_sim.ros.process import executor_of, process, serve
from litsim_sim.scenario.scenario import Scenario, packaged_scenarios

NAME = "litsim_server"
LOOK_S = 0.05  # [s] between two looks at what a launch does
END_S = 60.0  # [s] by which a launch that is interrupted has ended


class SimulationServer(Node):
    """Starts and ends launches as its services are asked to."""

    def __init__(self, options: Sequence[str], command: Sequence[str], out: Path, worlds: Path | None = None) -> None:
        """Make it, to launch with `options` and the `command` of a stack, and to record into folders in `out`.

        Clients may load scenarios of the package, and the files in the folder `worlds`.
        """
        if srv is None:
            raise not_installed("simulation_interfaces")
        super().__init__(NAME)
        self._options, self._command, self._out = [*options], [*command], out
        self._worlds = None if worlds is None else worlds.resolve()
        self._scenario = ""  # the last that was loaded: its name or file
        self._run: subprocess.Popen[bytes] | None = None
        self._ready = self.create_client(srv.GetSimulationState, service_name("GetSimulationState"))
        for name, answer in (
            ("LoadWorld", self._load),
            ("UnloadWorld", self._unload),
            ("ResetSimulation", self._reset),
        ):
            self.create_service(getattr(srv, name), service_name(name), answering(answer))

    def end_run(self) -> None:
        """Ends the run that is on, if any, as Ctrl-C does, so that it is recorded up to there."""
        if self._run is not None and self._run.poll() is None:
            self._run.send_signal(signal.SIGINT)
            try:
                self._run.wait(END_S)
            except subprocess.TimeoutExpired:
                self._run.kill()
                self._run.wait()
        self._run = None

    def _load(self, request: Any, response: Any) -> None:
        wanted = request.world_resource.uri
        if not wanted:
            raise Refused(response.NO_RESOURCE, "uri is empty, expected a scenario: a name or a file")
        try:
            scenario = self._permitted(wanted)
            world = world_of(Scenario.load(scenario).name)
        except InputError as error:
            raise Refused(response.RESOURCE_PARSE_ERROR, printable(reason(error))) from error
        self._scenario = scenario
        self._begin()
        response.world = world

    def _permitted(self, wanted: str) -> str:
        """Returns a scenario that a client wants: a name, or the path of a file that the server was told to give.

        Raises:
            InputError: there is none, or it is elsewhere, of which nothing is told.
        """
        if wanted in packaged_scenarios():
            return wanted
        if self._worlds is not None:
            path = (self._worlds / wanted).resolve()
            if path.is_relative_to(self._worlds) and path.is_file():
                return str(path)
        files = "" if self._worlds is None else ", and files in the folder of --worlds"
        raise InputError(f"{shown(wanted)}: no such scenario, expected one of {', '.join(packaged_scenarios())}{files}")

    def _unload(self, _: Any, response: Any) -> None:
        if self._run is None or self._run.poll() is not None:
            raise Refused(response.NO_WORLD_LOADED, "no run is on")
        self.end_run()

    def _reset(self, request: Any, _: Any) -> None:
        if request.scope not in {request.SCOPE_DEFAULT, request.SCOPE_ALL}:
            text = f"scope {request.scope}: a run can only begin anew as a whole, expected {request.SCOPE_ALL}"
            raise Refused(msg.Result.RESULT_FEATURE_UNSUPPORTED, text)
        if not self._scenario:
            raise Refused(msg.Result.RESULT_INCORRECT_STATE, "no scenario has been loaded")
        self._begin()

    def _begin(self) -> None:
        """Launches the scenario in place of the run that is on, until its bridge has services."""
        self.end_run()
        until = time.monotonic() + END_S
        while self._ready.service_is_ready():  # that of the last bridge, whose end is not known here yet
            if time.monotonic() > until:
                raise Refused(msg.Result.RESULT_OPERATION_FAILED, "another run is on in this domain")
            time.sleep(LOOK_S)
        count = len([*self._out.glob("[0-9]*")])
        own = ["--scenario", self._scenario, "--out", str(self._out / f"{count:03}"), "--served"]
        domain = ["--domain-id", str(self.context.get_domain_id())]
        command = ["--", *self._command] if self._command else []
        launch = str(find_executable("litsim_sim", "launch"))
        self._run = subprocess.Popen([launch, *self._options, *own, *domain, *command], stdin=subprocess.DEVNULL)
        while not self._ready.service_is_ready():
            if self._run.poll() is not None:
                text = f"the launch has ended with status {self._run.returncode}; its output says why"
                raise Refused(msg.Result.RESULT_OPERATION_FAILED, text)
            time.sleep(LOOK_S)


def serve_simulations(options: Sequence[str], command: Sequence[str], out: Path, worlds: Path | None) -> None:
    """Serves until Ctrl-C, with the arguments of :class:`SimulationServer`."""
    with process(interrupted=0):
        node = SimulationServer(options, command, out, worlds)
        executor = executor_of(node)
        try:
            while True:
                serve(executor)
        finally:
            node.end_run()
