"""A tracker and a stage in a closed loop, both simulated devices. closed_loop_rig.py [SECONDS].

This process is for the devices, a thread each. Another one estimates, as the devices must not wait
for that, and a third one plans, as the estimate must not wait either.
"""

import multiprocessing
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from glissando import CoilReadings, FixedLagSmoother, load_robot
from glissando.hardware.capture.simulated import simulated_rig
from glissando.hardware.drivers import Aurora, Slide
from glissando.io.shipped_robots import robot_file
from glissando.planning import (
    MovingInterval,
    ProcessPlanner,
    Replanner,
    Zone,
    path_space_of,
    sliding_sensor,
)
from glissando.planning.replan import Route
from glissando.simulation import load_bench

TICK, STREAMED, TIP = 0.25, 0.3, 0.7  # s between updates; s for which the path is settled; m


def estimate(readings, travels, routes, ended, lasts):
    """The estimator's process: receives poses and travels, sends the path whenever it changes."""
    robot, bench = load_robot("sliding700"), load_bench(robot_file("sliding700"))
    zone = Zone(MovingInterval((0.0, lasts), (0.62, 0.68), (0.52, 0.58)))
    sensor, path_space = sliding_sensor(robot), path_space_of(bench.slide, TIP, TIP, horizon=5.0)
    smoother, slide = FixedLagSmoother(robot, robot.arclength_nodes, window=6), [(0.0, 0.0)]
    with ProcessPlanner() as planner:
        replanner = Replanner(sensor, path_space, [zone], node_step=0.5, lead=0.7, planner=planner)
        routes.send("ready")
        begin = routes.recv()
        while (now := time.monotonic() - begin) < lasts and not ended.is_set():
            slide += [travels.get() for _ in range(travels.qsize())]
            rows = [readings.get() for _ in range(readings.qsize())]
            when, poses = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
            place = TIP - np.interp(when, *np.transpose(slide))  # where the coil was then
            smoother.add(
                CoilReadings(
                    time=when - begin, arclength=place, values=poses.reshape(-1, 4, 4),
                    cov=sensor.cov, name="coil",
                )
            )  # fmt: skip
            smoother.advance(now)
            last = replanner.plan
            if replanner.next(smoother, time.monotonic() - begin + STREAMED) is not last:
                routes.send(replanner.route)
            spent = time.monotonic() - begin - now
            std = smoother.at(*zone.points(np.array([now]))).std_position
            print(
                f"{now:5.2f} s: coil at {1e3 * replanner.at(now)[0]:.0f} mm, the zone is known to "
                f"± {1e3 * np.sqrt(np.mean(std**2)):.1f} mm; an update takes {1e3 * spent:.0f} ms",
                flush=True,
            )
            time.sleep(max(0.0, TICK - spent))


def listen(rig, moving, readings):
    """The tracker's thread."""
    with Aurora(rig.tracker) as tracker:
        while not moving.done():
            frame = tracker.read()
            for port in (port for port in frame.ports if port.good):
                readings.put((frame.time, rig.frame @ port.pose))


def drive(rig, routes, begin, lasts, travels):
    """The stage's thread: it goes where the newest route says."""
    route = Route(TIP)

    def wanted(into):
        nonlocal route
        while routes.poll():
            route = routes.recv()
        return TIP - float(route.at(late + into)[0])

    with Slide(rig.slide, rig.stage) as slide:
        slide.home_here(0.0)
        late = time.monotonic() - begin
        for reading in slide.pursue(wanted, lasts - late):
            travels.put((reading.time, reading.travel))


def main(lasts=20.0):
    """Start the processes and drive the devices."""
    context = multiprocessing.get_context("spawn")
    readings, travels = context.Queue(), context.Queue()
    for queue in (readings, travels):
        queue.cancel_join_thread()  # to end, nobody waits until all that was sent is read
    (routes, theirs), ended = context.Pipe(), context.Event()
    process = context.Process(target=estimate, args=(readings, travels, theirs, ended, lasts))
    process.start()
    routes.recv()
    try:
        with simulated_rig() as rig, ThreadPoolExecutor() as pool:
            begin = time.monotonic()
            routes.send(begin)
            moving = pool.submit(drive, rig, routes, begin, lasts, travels)
            listening = pool.submit(listen, rig, moving, readings)
            moving.result()
            listening.result()
    finally:
        ended.set()  # also where a device is lost
        process.join(10.0)
        process.terminate()  # one that waits for what is gone


if __name__ == "__main__":
    main(*(float(a) for a in sys.argv[1:2]))
