"""Files as a tracker and motion capture write them, of any poses."""

import numpy as np
from scipy.spatial.transform import Rotation


def tracker_csv(path, tracks, frames=None, unit="rad"):
    """A Tracker CSV of poses by name, missing where NaN; rotations by SciPy's rotation vectors."""
    count = len(next(iter(tracks.values())))
    heads = [""] * 2
    for name in tracks:
        heads += [f"Global Angle {name}:{name}"] + [""] * 5
    lines = ["Objects", str(len(tracks)), ",".join(heads)]
    lines += [",".join(["Frame", "Sub Frame", *["RX", "RY", "RZ", "TX", "TY", "TZ"] * len(tracks)])]
    lines += [",".join(["", "", *[*[unit] * 3, *["mm"] * 3] * len(tracks)])]
    for k in range(count):
        cells = [str(k + 1 if frames is None else frames[k]), "0"]
        for track in tracks.values():
            if np.isnan(track[k, 0, 3]):
                cells += [""] * 6
                continue
            turn = Rotation.from_matrix(track[k, :3, :3]).as_rotvec(degrees=unit == "deg")
            cells += [repr(float(v)) for v in [*turn, *(1e3 * track[k, :3, 3])]]
        lines.append(",".join(cells))
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def ndi_csv(path, tools, frames, *, clock=None, markers=0):
    """An NDI CSV of poses by name, 'Missing' where NaN."""
    seen = ["State", "Tx", "Ty", "Tz"] * markers
    block = ["Frame", *(["Time [sec]"] if clock is not None else []), "Face", "State"]
    block += ["Q0", "Qx", "Qy", "Qz", "Tx", "Ty", "Tz", "Error", *["Markers"] * bool(markers)]
    heads = ["Tools"]
    for port, name in enumerate(tools, start=1):
        heads += [f"Port 0x{port:02X}: {name}  s/n:3E4C880C", *block, *seen]
    lines = [",".join(heads)]
    for k, frame in enumerate(frames):
        cells = [str(len(tools))]
        for port, (name, track) in enumerate(tools.items(), start=1):
            cells += [f"Port 0x{port:02X}: {name}  s/n:3E4C880C", str(frame)]
            cells += [repr(float(clock[k])), "1"] if clock is not None else ["1"]
            if np.isnan(track[k, 0, 3]):
                cells += ["Missing", *["-3.697314E28"] * 7, "0.0"]
            else:
                x, y, z, w = Rotation.from_matrix(track[k, :3, :3]).as_quat()
                cells += ["OK", *(repr(float(v)) for v in [w, x, y, z, *(1e3 * track[k, :3, 3])])]
                cells += ["0.1"]
            cells += [str(markers)] * bool(markers) + ["OK", "9", "8", "7"] * markers
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path


def hole(track, *rows):
    track = track.copy()
    track[list(rows)] = np.nan
    return track


def semicolons(path):
    """The same text as a program of continental Europe writes it: ; and decimal commas."""
    path.write_text(path.read_text().replace(",", ";").replace(".", ","))
    return path


def motive_csv(path, bodies, markers, *, rate=120.0, turn="Quaternion", unit="Meters"):
    """A Motive CSV of poses and points by name, empty where NaN."""
    size = {"Meters": 1.0, "Millimeters": 1e3}[unit]
    settings = ["Format Version", "1.23", "Take Name", "take", "Export Frame Rate", f"{rate}"]
    settings += ["Rotation Type", turn, "Length Units", unit, "Coordinate Space", "Global"]
    axes = ["X", "Y", "Z", "W"] if turn == "Quaternion" else ["X", "Y", "Z"]
    kinds, names, quantities, heads = (["", t] for t in ("Type", "Name", "", ""))
    heads = ["Frame", "Time (Seconds)"]
    for name in bodies:
        kinds += ["Rigid Body"] * (len(axes) + 4)
        names += [name] * (len(axes) + 4)
        quantities += ["Rotation"] * len(axes) + ["Position"] * 3 + ["Mean Marker Error"]
        heads += [*axes, "X", "Y", "Z", ""]
    for name in markers:
        kinds, names = kinds + ["Marker"] * 3, names + [name] * 3
        quantities, heads = quantities + ["Position"] * 3, [*heads, "X", "Y", "Z"]
    identities = ["", "ID"] + ["A1"] * (len(names) - 2)
    lines = [",".join(row) for row in (settings, [], kinds, names, identities, quantities, heads)]
    for k in range(len(next(iter([*bodies.values(), *markers.values()])))):
        cells = [str(k), repr(k / rate)]
        for track in bodies.values():
            if np.isnan(track[k, 0, 3]):
                cells += [""] * (len(axes) + 4)
                continue
            rotation = Rotation.from_matrix(track[k, :3, :3])
            numbers = rotation.as_quat() if turn == "Quaternion" else None
            if numbers is None:
                angles = dict(zip(turn, rotation.as_euler(turn, degrees=True), strict=True))
                numbers = [angles[axis] for axis in "XYZ"]
            cells += [repr(float(v)) for v in [*numbers, *(size * track[k, :3, 3])]] + ["0.0001"]
        for track in markers.values():
            gone = np.isnan(track[k, 0])
            cells += [""] * 3 if gone else [repr(float(v)) for v in size * track[k]]
        lines.append(",".join(cells))
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def qualisys_tsv(path, tracks, *, rate=100.0, titles=True, frames=None):
    """A Qualisys TSV of poses (6D) or points (3D) by name, zeros where NaN; frames from 1."""
    bodies = next(iter(tracks.values())).ndim == 3
    count, word = len(next(iter(tracks.values()))), "BODY" if bodies else "MARKER"
    lines = [f"NO_OF_FRAMES\t{count}", "NO_OF_CAMERAS\t8", f"FREQUENCY\t{rate:g}"]
    lines += ["DESCRIPTION\t--", "TIME_STAMP\t2026-11-22, 10:00:00.123\t4711.5"]
    lines += [f"DATA_INCLUDED\t{'6D' if bodies else '3D'}", "\t".join([f"{word}_NAMES", *tracks])]
    parts = ["X", "Y", "Z"]
    if bodies:
        parts += ["Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9))]
    if titles:
        lines.append("\t".join(["Frame", "Time", *(f"{n} {p}" for n in tracks for p in parts)]))
    for k in range(count):
        frame = frames[k] if frames else k + 1
        cells = [str(frame), f"{(frame - 1) / rate:.5f}"] if titles else []
        for track in tracks.values():
            if np.isnan(track[k].flat[-1] if not bodies else track[k, 0, 3]):
                cells += ["0.000"] * len(parts)
                continue
            at = 1e3 * (track[k, :3, 3] if bodies else track[k])
            numbers = [*at, 1, 2, 3, 0.5, *track[k, :3, :3].T.ravel()] if bodies else at
            cells += [f"{v:.9f}" for v in numbers]
        lines.append("\t".join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path
