"""Page of the comparison: text, sentences on time, and figure."""

from textwrap import fill

from matplotlib.figure import Figure

TEXT = """\
# Comparison with other methods

`benchmarks/peers.py` measures every number on this page and writes it.

Sensors read a robot at a few places, and each method estimates the position between them. Every
shape is static and estimated from its own readings only. Our `estimate_static` solves all
shapes together; GTSAM ({gtsam}) solves one graph after another. Runs of the two alternate on one
thread of one process. Times are processor seconds from arrays of readings to the mean and
covariance at all queried places.

![Error of every method; how fast confidence settles as nodes are added](peers.png)

## The same problem

The problem has {each} shapes of a steel rod of 0.6 m, computed by another group's solver,
SoroSim. The base is fixed, and the pose is read at {read} m. Both methods have the same prior and
noise, with shear so soft that GTSAM can factor dense grids. GTSAM's factor treats the six
components of a step as independent; ours is the exact transition of the step. Therefore GTSAM needs
many nodes for the result that ours gives with one node per reading. The table gives distances from
the limit of many nodes, the largest over shapes and places. With GTSAM's factors in our estimator
both agree on every grid to 1e-6 in the mean and far better than 1 % in the standard deviation
(`benchmarks/tests/test_peers.py`). GTSAM starts from curves through the readings, ours from a
straight robot.

| | nodes | mean, largest distance (mm) | std, largest distance | ms a shape |
|---|---|---|---|---|
{refinement}

{ratios}

## Accuracy

The parameters of each method's prior are those that best predict shapes other than these {rods}.
The table gives errors of position at the {asked} stations without a reading, all between
readings.

| steel rod | RMSE (mm) | median (mm) | inside 95 % | ms a shape |
|---|---|---|---|---|
{steel}

The second problem has {moments} times of the public recording `fast_contact`, 10 to 30 s, with
numbers chosen on `slow_free_space`. Each is a separate shape, estimated only from the tracker's
poses of base and tip; motion capture at 0.1165, 0.233 and 0.3495 m is the truth. Readings at both
ends contain little information about a body of two segments in contact: no method is clearly
best, and a prior chosen on slow motion is overconfident. [Results](results.md) shows the
improvement from motion over time and gyroscopes. Methods that model a rod's mechanics are
compared in [loads](loads.md#beside-other-methods).

| real robot | RMSE (mm) | median (mm) | inside 95 % | ms a shape |
|---|---|---|---|---|
{real}
"""


def ratios(far, times, each):
    """Sentences on the ratio of times, for equal nodes and for equal accuracy of confidence."""
    few, many = min(k[1] for k in far if k[0] == "ours"), max(k[1] for k in far if k[0] == "ours")
    same = times["GTSAM", many] / times["ours", many]
    fewest = times["GTSAM", many] / times["ours", few]
    within = [key for key in far if far[key][1] < 1.0]
    ours_, theirs = (
        min([key for key in within if key[0] == who], key=times.get) for who in ("ours", "GTSAM")
    )
    text = (
        f"Our estimate of {each} shapes is **{same:.1f} times** as fast as GTSAM's on the same "
        f"{many} nodes, and **{fewest:.1f} times** with nodes at base and readings only, which is "
        f"sufficient. For standard deviations within 1 % of the limit, GTSAM needs {theirs[1]} "
        f"nodes and ours {ours_[1]}: ours is then **{times[theirs] / times[ours_]:.0f} times** as "
        f"fast."
    )
    return fill(text, 100)


def draw(path, tables, far, times):
    """Draw two panels: RMSE of every method, and error of confidence against time."""
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = list(tables["steel rod"])[::-1]
    for marker, (problem, table) in zip("os", tables.items(), strict=True):
        left.plot([table[name]["rmse"] for name in names], range(len(names)), marker, label=problem)
    left.set_yticks(range(len(names)), [name.replace("*", "") for name in names])
    left.set(xscale="log", xlabel="RMSE between readings (mm)")
    left.grid(axis="x", which="both", color="0.9")
    left.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, 1.12), ncols=2)
    for who, colour in (("GTSAM", "#D55E00"), ("ours", "#0072B2")):
        keys = [key for key in far if key[0] == who]
        at = [times[key] for key in keys], [far[key][1] for key in keys]
        right.plot(*at, "o-", color=colour, label=who)
        for key, x, y in zip(keys, *at, strict=True):
            right.annotate(f"{key[1]} nodes", (x, y), (5, 5), textcoords="offset points")
    right.margins(0.2)
    right.axhline(1.0, color="0.6", linewidth=0.8, linestyle="--")
    right.set(xscale="log", yscale="log", xlabel="time a shape (ms)")
    right.set_ylabel("largest error of standard deviation (%)")
    right.legend(frameon=False)
    figure.savefig(path, dpi=110)
