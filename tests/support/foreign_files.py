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
