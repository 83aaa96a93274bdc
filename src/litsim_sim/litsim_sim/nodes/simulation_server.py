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

from litsim_sim.core.errors import InputError, not_installed, reason
from litsim_sim.launch.nodes import find_executable
from litsim_sim.nodes.simulation_services import msg, result_of, service_name, srv, world_of
from litsim_sim.ros.process import executor_of, process, serve
from litsim_sim.scenario.scenario import Scenario

NAME = "litsim_server"
LOOK_S = 0.05  # [s] between two looks at what a launch does
END_S = 60.0  # [s] by which a launch that is interrupted has ended


class SimulationServer(Node):
    """Starts and ends launches as its services are asked to."""

    def __init__(self, options: Sequence[str], command: Sequence[str], out: Path) -> None:
        """Make it, to launch with `options` and the `command` of a stack, and to record into folders in `out`.

        Raises:
            InputError: simulation_interfaces is not installed.
        """
        if srv is None:
            raise not_installed("simulation_interfaces")
        super().__init__(NAME)
        self._options, self._command, self._out = [*options], [*command], out
        self._scenario = ""  # the last that was loaded: its name or file
        self._run: subprocess.Popen[bytes] | None = None
        self._ready = self.create_client(srv.GetSimulationState, service_name("GetSimulationState"))
        for name, answer in (
            ("LoadWorld", self._load),
            ("UnloadWorld", self._unload),
            ("ResetSimulation", self._reset),
        ):
            self.create_service(getattr(srv, name), service_name(name), answer)

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

    def _load(self, request: Any, response: Any) -> Any:
        wanted = request.world_resource.uri
        if not wanted:
            response.result = result_of(response.NO_RESOURCE, "uri is empty, expected a scenario: a name or a file")
            return response
        try:
            world = world_of(Scenario.load(wanted).name)
        except InputError as error:
            response.result = result_of(response.RESOURCE_PARSE_ERROR, reason(error))
            return response
        self._scenario = wanted
        response.result = self._begin()
        if response.result.result == msg.Result.RESULT_OK:
            response.world = world
        return response

    def _unload(self, _: Any, response: Any) -> Any:
        if self._run is None or self._run.poll() is not None:
            response.result = result_of(response.NO_WORLD_LOADED, "no run is on")
        else:
            self.end_run()
            response.result = result_of(msg.Result.RESULT_OK)
        return response

    def _reset(self, request: Any, response: Any) -> Any:
        if request.scope not in (request.SCOPE_DEFAULT, request.SCOPE_ALL):
            text = f"scope {request.scope}: a run can only begin anew as a whole, expected {request.SCOPE_ALL}"
            response.result = result_of(msg.Result.RESULT_FEATURE_UNSUPPORTED, text)
        elif not self._scenario:
            response.result = result_of(msg.Result.RESULT_INCORRECT_STATE, "no scenario has been loaded")
        else:
            response.result = self._begin()
        return response

    def _begin(self) -> Any:
        """Launches the scenario in place of the run that is on; returns the result once its bridge has services."""
        self.end_run()
        while self._ready.service_is_ready():  # that of the last bridge, whose end is not known here yet
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
                return result_of(msg.Result.RESULT_OPERATION_FAILED, text)
            time.sleep(LOOK_S)
        return result_of(msg.Result.RESULT_OK)


def serve_simulations(options: Sequence[str], command: Sequence[str], out: Path) -> None:
    """Serves until Ctrl-C, with the arguments of :class:`SimulationServer`."""
    with process(interrupted=0):
        node = SimulationServer(options, command, out)
        executor = executor_of(node)
        try:
            while True:
                serve(executor)
        finally:
            node.end_run()
