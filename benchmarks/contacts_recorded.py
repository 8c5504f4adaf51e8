"""Contact detection on a real robot, by windows of the public space-time recordings.

Unpublished properties of its body are assumed, see fast_contact.py: a nitinol rod under loads that
bend it by a third of its length, which represent its tendons. Trackers and gyroscopes are used,
motion capture is not. Nothing is fitted.

Usage: contacts_recorded.py FOLDER [--windows 0:10 10:20] [--rate 10] [--json]
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from fast_contact import LOADS, NODES, priors
from glissando import Grid, estimate, load_recording, load_robot
from glissando.errors import GlissandoError
from glissando.estimation.contact import scan_contacts

MASS, TIME_SCALE = 0.05, 0.5  # kg/m; s


def scanned(folder, window, rate=10.0):
    """Scan for contacts in a window (s) of a recording, at `rate` Hz."""
    robot, recording = load_robot("tdcr466-segments"), load_recording(folder)
    prior = priors(robot.length, MASS)["without inertia"]
    prior = replace(
        prior,
        psd_load=prior.psd_load / LOADS**2,
        var_tip=prior.var_tip / LOADS**2,
        time_scale=TIME_SCALE,
    )
    used, _ = recording.choose(None, None)
    readings, _ = recording.readings(used, robot, window)
    times = np.linspace(*window, round((window[1] - window[0]) * rate) + 1)
    grid = Grid(np.linspace(0.0, robot.length, NODES), times)
    found = estimate(prior, grid, readings, sensor_parameters=robot.sensor_parameters)
    return scan_contacts(found, times)


def main():
    """Print a row per window, or JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--windows", nargs="+", default=["0:10", "10:20"], help="s")
    parser.add_argument("--rate", type=float, default=10.0, help="times a second (default 10)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    rows = []
    try:
        for text in options.windows:
            scan = scanned(options.folder, [float(part) for part in text.split(":")], options.rate)
            above = scan.evidence - scan.threshold
            touched = scan.time[scan.detected].tolist()
            rows.append({"window": text, "times": scan.time.size, "touched": touched,
                         "most_above_threshold": float(above.max())})  # fmt: skip
            if not options.json:
                first = f", first at {touched[0]:.1f} s" if touched else ""
                print(f"{text} s: touched at {len(touched)} of {scan.time.size} times{first}; "
                      f"evidence less threshold at most {above.max():.1f}", flush=True)  # fmt: skip
    except GlissandoError as problem:
        print(problem)
        return 2
    if options.json:
        print(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
