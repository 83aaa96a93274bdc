"""Trajectories as SUMO's ``--fcd-output``, with the net and the types of vehicles beside it."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.exports.export import Content, Export, beside, write_xml
from litsim_data.sources.sumo import SIZES
from litsim_sim.core.scene import Kind
from litsim_sim.io.files import replacing
from litsim_sim.io.input_files import open_input

CLASSES = {kind: next(name for name, size in SIZES.items() if size[0] == kind.name.lower()) for kind in Kind}
"""SUMO's vehicle class for each of our kinds."""
DIGITS = 6  # of written positions [m], headings [deg] and speeds [m/s]


class SumoTrajectories(Export):
    """Front centres at every frame; pedestrians are persons. It is read by SUMO's tools and by `data import`."""

    endings, content = (".fcd.xml",), "SUMO's trajectories (fcd-output), with types and net beside"

    def write(self, content: Content, out: Path) -> list[str]:
        """See :class:`.export.Export`."""
        table = content.motion()
        x = table["x"] + 0.5 * table["length"] * np.cos(table["yaw"])
        y = table["y"] + 0.5 * table["length"] * np.sin(table["yaw"])
        values = {"x": x, "y": y, "angle": (90.0 - np.rad2deg(table["yaw"])) % 360.0, "speed": table["speed"]}
        if content.net is not None:
            lane_map = content.lanes()
            nearest = lane_map.nearest(x.to_numpy(), y.to_numpy(), table["yaw"].to_numpy())
            lanes = [lane_map.lanes[row].id for row in nearest.lane]
            values["pos"] = np.clip(nearest.s, 0.0, [lane_map.lanes[row].length for row in nearest.lane])
        columns = {name: [f"{value:.{DIGITS}f}" for value in column] for name, column in values.items()}
        if content.net is not None:
            columns["lane"] = lanes
        kinds = [Kind(kind) for kind in table["kind"]]
        sizes = list(zip(kinds, table["length"].tolist(), table["width"].tolist(), strict=True))
        types = {size: f"{size[0].name.lower()}_{number}" for number, size in enumerate(sorted({*sizes}))}
        root, moments = ET.Element("fcd-export"), {}
        for row, (time, vehicle) in enumerate(zip(table["t"], table["vehicle_id"], strict=True)):
            if time not in moments:
                moments[time] = ET.SubElement(root, "timestep", {"time": f"{time:.2f}"})
            attributes = {"id": str(vehicle), "type": types[sizes[row]]}
            attributes |= {name: column[row] for name, column in columns.items()}
            if kinds[row] is Kind.PEDESTRIAN and "lane" in attributes:
                attributes["edge"] = attributes.pop("lane").rpartition("_")[0]
            ET.SubElement(moments[time], "person" if kinds[row] is Kind.PEDESTRIAN else "vehicle", attributes)
        additional = ET.Element("additional")
        for (kind, length, width), name in types.items():
            size = {"length": f"{length:.{DIGITS}f}", "width": f"{width:.{DIGITS}f}"}
            ET.SubElement(additional, "vType", {"id": name, "vClass": CLASSES[kind], **size})
        of_types = beside(out, ".types.xml")
        files = [of_types]
        write_xml(root, out)
        write_xml(additional, of_types)
        if content.net is not None:
            files.append(beside(out, ".net.xml"))
            with replacing(files[-1]) as new, open_input(content.net, "net") as net:
                new.write_bytes(net.read())
        return [content.counts, f"beside it: {', '.join(file.name for file in files)}"]
