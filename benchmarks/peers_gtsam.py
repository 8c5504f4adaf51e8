"""Static shapes by GTSAM: white-noise-on-acceleration factors along arclength, on SE(3).

Twists of this interface are [linear, angular]; inside, GTSAM's are [angular, linear].
"""

from itertools import pairwise

import gtsam
import numpy as np

from glissando.model.priors.rest_shape import STRAIGHT
from peers_curves import between, knots

SWAP = np.array([3, 4, 5, 0, 1, 2])


def solve(problem, numbers, refined=0, *, tight=False):
    """Positions (M, 3) at the problem's queries with covariances (M, 3, 3), in the world.

    Nodes are the problem's stations, each interval halved `refined` times; `tight` iterates to
    machine precision.
    """
    nodes = refine(problem.stations, refined)
    at = np.searchsorted(nodes, problem.query_arclength - 1e-9)
    place, cov = np.empty((at.size, 3)), np.empty((at.size, 3, 3))
    for shape in range(problem.count):
        graph, values = posed(problem, numbers, nodes, shape)
        found = optimised(graph, values, tight=tight)
        marginals = gtsam.Marginals(graph, found)
        for row in np.flatnonzero(problem.query_shape == shape):
            key = pose_key(at[row])
            pose = found.atPose3(key)
            turn = pose.rotation().matrix()
            spread = marginals.marginalCovariance(key)[3:, 3:]
            place[row], cov[row] = pose.translation(), turn @ spread @ turn.T
    return place, cov


def refine(nodes, times):
    """Nodes with every interval halved `times` times."""
    for _ in range(times):
        nodes = np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
    return nodes


def pose_key(node):
    return gtsam.symbol("x", int(node))


def strain_key(node):
    return gtsam.symbol("e", int(node))


def posed(problem, numbers, nodes, shape):
    """Factor graph and initial guess of one shape of the problem.

    The initial guess has piecewise constant strain between readings: from a straight robot, which
    suffices for ours, some shapes converge to other solutions.
    """
    diagonal = gtsam.noiseModel.Diagonal
    mine = problem.reading_shape == shape
    values = gtsam.Values()
    pose, strain = between(*knots(problem, shape), nodes)
    for node in range(nodes.size):
        values.insert(pose_key(node), gtsam.Pose3(pose[node]))
        values.insert(strain_key(node), strain[node, SWAP])
    graph = gtsam.NonlinearFactorGraph()
    if problem.base_std:
        firm = gtsam.noiseModel.Isotropic.Sigma(6, problem.base_std)
        graph.add(gtsam.PriorFactorPose3(pose_key(0), gtsam.Pose3(problem.base_pose), firm))
    spread = diagonal.Variances(numbers.base_strain[SWAP])
    graph.add(gtsam.PriorFactorVector6(strain_key(0), STRAIGHT[SWAP], spread))
    psd = numbers.psd[SWAP]
    states = [gtsam.StateData(pose_key(i), strain_key(i), s) for i, s in enumerate(nodes)]
    for one, next_ in pairwise(states):
        graph.add(gtsam.WnoaMotionFactorPose3(one, next_, psd))
    noise = diagonal.Sigmas(numbers.noise[SWAP])
    at = np.searchsorted(nodes, problem.reading_arclength[mine] - 1e-9)
    for node, pose in zip(at, problem.reading_pose[mine], strict=True):
        graph.add(gtsam.PriorFactorPose3(pose_key(node), gtsam.Pose3(pose), noise))
    return graph, values


def optimised(graph, values, *, tight=False):
    """Optimise by Levenberg–Marquardt; plain Gauss–Newton fails on dense nodes."""
    parameters = gtsam.LevenbergMarquardtParams()
    if tight:
        parameters.setRelativeErrorTol(1e-15)
        parameters.setAbsoluteErrorTol(1e-15)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
