"""Small tables in the layouts of published data sets; nothing in them is real."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

FOOT = 0.3048
PNEUMA = ("track_id", "type", "traveled_d", "avg_speed", "lat", "lon", "speed", "lon_acc", "lat_acc", "time")
SPEEDS = (8.0, 10.0, 13.0)  # [m/s] of three vehicles that drive north, one beside the other
TIMES = np.arange(0.0, 8.0, 0.04)
Made = Callable[[Path], Path]


def pneuma(folder: Path) -> Path:
    lines = ["; ".join(PNEUMA)]
    for number, speed in enumerate(SPEEDS, 1):
        cells = [str(number), "Medium Vehicle" if number == 3 else "Car", "0.0", "0.0"]
        for t in TIMES:
            north = 37.98 + speed * t / 110_950.0
            cells += [f"{north:.8f}", f"{23.735 + 0.00004 * number:.8f}", f"{3.6 * speed:.4f}", "0", "0", f"{t:.6f}"]
        lines.append("; ".join(cells) + "; ")
    path = folder / "20181024_d1_0830_0900.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def i24_motion(folder: Path) -> Path:
    records = [
        {
            "_id": {"$oid": f"6{number:023d}"},
            "timestamp": [1_669_118_400.0 + round(t, 2) for t in TIMES],
            "x_position": [(320_000.0 - speed * t / FOOT) for t in TIMES],  # westbound, of the rear
            "y_position": [12.0 * number + 6.0] * len(TIMES),
            "length": 12.0 / FOOT if number == 3 else 15.0,
            "width": 6.0,
            "direction": -1,
            "flags": ["stitched", "a"],
            "coarse_vehicle_class": 4 if number == 3 else 0,
        }
        for number, speed in enumerate(SPEEDS, 1)
    ]
    path = folder / "INCEPTION.json"
    path.write_text("[" + ",\n".join(map(json.dumps, records)) + "]")
    return path


def citysim(folder: Path) -> Path:
    rows = []
    for number, speed in enumerate(SPEEDS, 1):
        for frame in range(240):
            x, y, half, side = speed * frame / 30.0, 4.0 * number, 2.3, 0.95
            corners = [(x + half, y + side), (x - half, y + side), (x - half, y - side), (x + half, y - side)]
            feet = {"carCenterX": (x, y)} | {f"boundingBox{at}X": corner for at, corner in enumerate(corners, 1)}
            row = {"frameNum": frame, "carId": number, "speed": speed / 0.44704}
            for name, (east, down) in feet.items():
                row |= {name: 18.0 * east, name[:-1] + "Y": 18.0 * down}
                row |= {f"{name}ft": east / FOOT, f"{name[:-1]}Yft": down / FOOT}
            rows.append(row)
    path = folder / "FreewayC-01.csv"
    pd.DataFrame(rows).to_csv(path, index=False)
    return path


def songdo(folder: Path) -> Path:
    rows = [
        {
            "Vehicle_ID": number,
            "Local_Time": f"08:59:{52.0 + t:06.3f}" if t < 8.0 else f"09:00:{t - 8.0:06.3f}",
            "Local_X": 170_201.0 + 4.0 * number,
            "Local_Y": 532_274.0 + speed * t,
            "Vehicle_Length": 4.6,
            "Vehicle_Width": 1.9,
            "Vehicle_Class": 1 if number == 3 else 0,
            "Vehicle_Speed": "" if t < 0.1 else 3.6 * speed,
        }
        for number, speed in enumerate(SPEEDS, 1)
        for t in TIMES + 3.0
    ]
    path = folder / "2022-10-07_U_PM5.csv"
    pd.DataFrame(rows).to_csv(path, index=False)
    return path


def sind(folder: Path) -> Path:
    rows = [
        {
            "track_id": number,
            "frame_id": frame,
            "timestamp_ms": 1000.0 * t,
            "agent_type": "truck" if number == 3 else "car",
            "x": 4.0 * number,
            "y": 20.0 + speed * t,
            "vx": 0.0,
            "vy": speed,
            "yaw_rad": 0.5 * np.pi,
            "heading_rad": 0.5 * np.pi,
            "length": 4.6,
            "width": 1.9,
        }
        for number, speed in enumerate(SPEEDS, 1)
        for frame, t in enumerate(TIMES)
    ]
    path = folder / "Veh_smoothed_tracks.csv"
    pd.DataFrame(rows).to_csv(path, index=False)
    return path


WRITERS: tuple[Made, ...] = (pneuma, i24_motion, citysim, songdo, sind)
