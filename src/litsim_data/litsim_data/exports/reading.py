"""What `data export` is given: a run, a scenario, a recording or a net."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from litsim_data.exports.export import Content
from litsim_data.exports.table import trajectories
from litsim_sim.core.errors import InputError
from litsim_sim.record.run import NET_FILE, Run, read_run
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recorded_net import NET_ENDINGS, net_named, net_of
from litsim_sim.scenario.scenario import Scenario, packaged_nets, packaged_scenarios


@contextmanager
def opened(source: Path, net: str | None = None) -> Iterator[Content]:
    """Yields what `source` holds; that of a run has its net in a file for as long.

    Args:
        source: folder or MCAP file of a run, name or file of a scenario or a net, or a recording of any known format.
        net: packaged net or file that is taken instead of the one that a recording names.

    Raises:
        InputError: it cannot be read, or has a net of its own.
    """
    name = str(source)
    of_run = source.is_dir() or source.suffix == ".mcap"
    of_scenario = name in packaged_scenarios() or source.suffix in (".yaml", ".yml")
    of_net = name.endswith(NET_ENDINGS) or (not source.is_file() and name in packaged_nets())
    if net is not None and (of_run or of_scenario or of_net):
        raise InputError(f"{source}: --net names the net of a recording, which this is not")
    if of_run:
        with tempfile.TemporaryDirectory() as folder:
            yield run_content(read_run(source), Path(folder))
    elif of_scenario:
        yield _of_scenario(Scenario.load(name, coverage_min=0.0), source)
    elif of_net:
        net_file = source if source.is_file() else net_named(name)
        yield Content(net_file.name.split(".")[0], net_file, net=net_file)
    else:
        yield _of_recording(source, net)


def run_content(run: Run, folder: Path) -> Content:
    """Returns the content of a run, whose net is written into `folder`.

    Raises:
        InputError: the net or the scenario in the bag cannot be read.
    """
    net = folder / NET_FILE
    net.write_bytes(run.net_xml)
    rows = trajectories(run)
    free_from = int(rows["frame"].min()) + run.info.history_steps - int(rows["step"].min())
    map_file = net if run.net_xml else None
    return Content(run.info.scenario, run.path, rows, map_file, run.info.ego_id, free_from, run.signals)


def _of_scenario(scenario: Scenario, path: Path) -> Content:
    recording, header = scenario.recording, scenario.recording.header
    free_from = scenario.start_frame + scenario.history_steps
    origin = (header.source, header.licence)
    return Content(
        scenario.name, path, recording.table, scenario.net_path, scenario.ego_id, free_from, scenario.signals, *origin
    )


def _of_recording(path: Path, net: str | None) -> Content:
    recording = load_recording(path)
    header, table = recording.header, recording.table
    try:
        map_file = net_of(header, path, net)
    except InputError:
        if net is not None:
            raise
        map_file = None  # some formats need none
    first = int(table["frame"].min())
    return Content(header.name, path, table, map_file, None, first, None, header.source, header.licence)
