"""Cases of a joint calibration with the answer of scipy.optimize.least_squares, for reference.rs and together.rs.

    python3 make_cases.py        (numpy and scipy; writes case_*.json beside this file)

The equations are written down here a second time, from CONVENTIONS.md; SI units throughout. Unknown are the true poses of all views and
the instrument: backlash x, y, rotation; the map row by row; the rotation centre. In the case of several objectives all their views, and what
the first ones show of each other, are one sum of squares.
"""

import json
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

PRIORS = {"backlash": [30e-6, 30e-6, 1e-4], "lever_m": 0.3, "parcentric_m": 15e-6}
# What an axis that is not asked to move moves, as a share of its scatter.
STANDS = 0.01
# And what it trembles from the view of its last arrival to another.
TREMBLES = np.array([20e-9, 20e-9, 2e-7])
NOISE = np.array([0.03, 0.03, 2e-4])
# Of a view in a step of the solver, and of the instrument.
POSE_UNIT = np.array([1e-7, 1e-7, 1e-6])
INSTRUMENT_UNIT = np.array([1e-7, 1e-7, 1e-6] + [1e-10] * 4 + [1e-6] * 2)


def rotation(a):
    return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])


def specimen(kinematics, pose, c):
    x, th = pose[:2], pose[2]
    if kinematics == "moves_microscope":
        return rotation(th) @ c + x
    if kinematics == "specimen_rotation_on_top":
        return rotation(-th) @ (c - x)
    return rotation(-th) @ c - x


def optics_coordinate(kinematics, pose, s):
    x, th = pose[:2], pose[2]
    if kinematics == "moves_microscope":
        return rotation(-th) @ (s - x)
    if kinematics == "specimen_rotation_on_top":
        return rotation(th) @ s + x
    return rotation(th) @ (s + x)


def shown(kinematics, fixed, found, m, eta):
    """Where the centre of `found` lies in `fixed`, and the nearest rotation: by three points."""
    at = [
        np.linalg.solve(m, optics_coordinate(kinematics, fixed, specimen(kinematics, found, m @ p + eta)) - eta)
        for p in (np.zeros(2), np.array([500.0, 0.0]), np.array([0.0, 500.0]))
    ]
    a, b = (at[1] - at[0]) / 500, (at[2] - at[0]) / 500
    return np.array([*at[0], np.arctan2(a[1] - b[0], a[0] + b[1])])


def path(kinematics, eta, turns):
    """Views of a cross and of rotations about the centre; each with the side it is reached from."""
    away = [(0, 0), (84, 0), (84, 84), (0, 0)] + [(d, 0) for d in (130, 260, -130, -260)] + [(0, d) for d in (130, 260, -130, -260)]
    views = [(np.array([x * 1e-6, y * 1e-6, 0.0]), [1, 1, 1]) for x, y in away]
    views[3] = (views[3][0], [-1, -1, 1])
    for turn, side in turns:
        alpha = turn if kinematics == "moves_microscope" else -turn
        d = eta - rotation(alpha) @ eta
        x = {
            "moves_microscope": d,
            "specimen_rotation_on_top": -rotation(-alpha) @ d,
            "specimen_xy_on_top": -d,
        }[kinematics]
        views.append((np.array([*x, turn]), [side, -side, side]))
    return views


def case(name, kinematics, m, eta, backlash, arrival, turns, seed, coupled):
    rng = np.random.default_rng(seed)
    views = path(kinematics, eta, turns)
    sigma = np.array([a or 0.0 for a in arrival])
    # Of a stage that is not coupled an axis that keeps its place keeps what it is off.
    arrived = [[bool(coupled or k == 0 or views[k][0][a] != views[k - 1][0][a]) for a in range(3)] for k in range(len(views))]
    true, off = [], np.zeros(3)
    for (r, s), new in zip(views, arrived):
        off = np.where(new, -np.array(s) * backlash / 2 + sigma * rng.normal(size=3), off)
        true.append(r + off)
    pairs = []
    for j in range(len(views)):
        for i in range(j):
            b = shown(kinematics, true[i], true[j], m, eta)
            if abs(b[0]) < 380 and abs(b[1]) < 290:
                pairs.append((i, j, b + NOISE * rng.normal(size=3)))
    n = len(views)
    moving = np.array([a is not None for a in arrival])
    free = np.concatenate([np.tile(moving, n), moving, np.ones(4, bool), np.repeat(moving[2], 2)])
    unit = np.concatenate([np.tile(POSE_UNIT, n), INSTRUMENT_UNIT])
    start = np.concatenate([np.concatenate([r for r, _ in views]), np.zeros(3), (1.002 * m).ravel(), eta + [2e-5, -1e-5]])
    if not moving[2]:
        start[-2:] = 0.0

    def unpack(z):
        u = start.copy()
        u[free] += (z * unit[free])
        return u[: 3 * n].reshape(n, 3), u[3 * n : 3 * n + 3], u[3 * n + 3 : 3 * n + 7].reshape(2, 2), u[3 * n + 7 :]

    def residuals(z):
        poses, play, map_, centre = unpack(z)
        out = [((shown(kinematics, poses[i], poses[j], map_, centre) - b) / NOISE) for i, j, b in pairs]
        stood = np.zeros(3)
        for pose, (reported, side), new in zip(poses, views, arrived):
            off = pose - reported
            rest = np.hypot(STANDS * sigma, TREMBLES)
            rows = np.where(new, (off + np.array(side) * play / 2) / np.where(moving, sigma, 1.0), (off - stood) / rest)
            out.append(rows[moving])
            stood = np.where(new, off, stood)
        out.append((play / PRIORS["backlash"])[moving])
        out.append(centre / PRIORS["lever_m"])
        return np.concatenate(out)

    fit = least_squares(residuals, np.zeros(free.sum()), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=200)
    _, play, map_, centre = unpack(fit.x)
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = np.linalg.inv(fit.jac.T @ fit.jac) * np.outer(unit[free], unit[free])
    numbers = np.concatenate([play, map_.ravel(), centre])
    stored = {
        "made_by": "make_cases.py, scipy.optimize.least_squares",
        "priors": {"kinematics": kinematics, "arrival": arrival, **PRIORS},
        "views": [
            {"optics": 0, "reported": {"x_m": r[:2].tolist(), "theta_rad": float(r[2])}, "approach": s, "arrived": new}
            for (r, s), new in zip(views, arrived)
        ],
        "pairs": [
            {"fixed": i, "found": j, "centre_px": b[:2].tolist(), "angle_rad": float(b[2]), "covariance": np.diag(NOISE**2).tolist()}
            for i, j, b in pairs
        ],
        "numbers": numbers.tolist(),
        "covariance": covariance[3 * n :, 3 * n :].ravel().tolist(),
        "chi_sq": float(2 * fit.cost),
    }
    text = json.dumps(stored)
    (Path(__file__).parent / f"case_{name}.json").write_text(text + "\n")
    print(name, len(pairs), "pairs, chi-square", 2 * fit.cost, fit.message)


SHARED = {"angle_rad": 2e-4, "parcentric_m": 200e-6, "drift_m_per_s": 0.0}
LINK_NOISE = np.array([0.1, 0.1, 3e-4, 5e-4])


def linked(kinematics, fixed, found, a, b):
    """Where the centre of one objective lies in the view of another, the nearest rotation, and the logarithm of the scale."""
    at = [
        np.linalg.solve(a[0], optics_coordinate(kinematics, fixed, specimen(kinematics, found, b[0] @ p + b[1])) - a[1])
        for p in (np.zeros(2), np.array([100.0, 0.0]), np.array([0.0, 100.0]))
    ]
    u, v = (at[1] - at[0]) / 100, (at[2] - at[0]) / 100
    scale = 0.5 * np.log(abs(u[0] * v[1] - u[1] * v[0]))
    return np.array([*at[0], np.arctan2(u[1] - v[0], u[0] + v[1]), scale])


def all_shown(kinematics, poses, i, j, m, eta):
    """`shown` of all pairs i, j at once."""
    sign = 1.0 if kinematics == "moves_microscope" else -1.0

    def turned(a, v):
        c, s = np.cos(a), np.sin(a)
        return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)

    x, phi = poses[:, :2], sign * poses[:, 2]
    c = np.broadcast_to(eta, (len(i), 2))
    if kinematics == "moves_microscope":
        seen = turned(-phi[i], turned(phi[j], c) + x[j] - x[i])
    elif kinematics == "specimen_rotation_on_top":
        seen = turned(phi[j] - phi[i], c - x[j]) + x[i]
    else:
        seen = turned(-phi[i], turned(phi[j], c) - x[j] + x[i])
    back = np.linalg.inv(m)
    turn = phi[j] - phi[i]
    unit = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]).transpose(2, 0, 1)
    linear = back @ unit @ m
    angle = np.arctan2(linear[:, 1, 0] - linear[:, 0, 1], linear[:, 0, 0] + linear[:, 1, 1])
    return np.column_stack([(seen - eta) @ back.T, angle])


def together(name, kinematics, m, eta, backlash, arrival, turns, seed):
    """Three objectives, the first of 10x: all in one."""
    rng = np.random.default_rng(seed)
    sigma = np.array(arrival)
    optics = [(f * m @ np.diag([1 + 0.01 * k, 1]), eta + 15e-6 * rng.normal(size=2)) for k, f in enumerate((4.0, 2.0, 1.0))]
    views = path(kinematics, eta, turns)
    n = len(views)
    true = [[r - np.array(s) * backlash / 2 + sigma * rng.normal(size=3) for r, s in views] for _ in optics]
    pairs = []
    for poses, (m_o, eta_o) in zip(true, optics):
        own = []
        for j in range(n):
            for i in range(max(0, j - 5), j):
                b = shown(kinematics, poses[i], poses[j], m_o, eta_o)
                if abs(b[0]) < 380 and abs(b[1]) < 290:
                    own.append((i, j, b + NOISE * rng.normal(size=3)))
        pairs.append(own)
    both = [(0, 1), (1, 2), (0, 2)]
    links = [(a, b, linked(kinematics, true[a][0], true[b][0], optics[a], optics[b]) + LINK_NOISE * rng.normal(size=4)) for a, b in both]
    about = optics[0][0] @ np.linalg.inv(np.diag([4.0, 4.0]))
    u, _, v = np.linalg.svd(about)
    about = u @ v
    each = 3 * n + 6
    unit = np.concatenate([INSTRUMENT_UNIT[:3]] + [np.concatenate([INSTRUMENT_UNIT[3:], np.tile(POSE_UNIT, n)])] * 3 + [[1e-5, 1e-6, 1e-6]])
    reported = np.concatenate([r for r, _ in views])
    goals, sides = np.array([r for r, _ in views]), np.array([s for _, s in views])
    index = [np.array([(i, j) for i, j, _ in seen]).T for seen in pairs]
    measured = [np.array([b for _, _, b in seen]) for seen in pairs]
    for poses, (m_o, eta_o), (i, j) in zip(true, optics, index):
        both = [all_shown(kinematics, np.array(poses), i, j, m_o, eta_o), [shown(kinematics, poses[a], poses[b], m_o, eta_o) for a, b in zip(i, j)]]
        assert np.allclose(*both, atol=1e-6), name
    start = np.concatenate([np.zeros(3)] + [np.concatenate([1.001 * o[0].ravel(), o[1] + [2e-5, -1e-5], reported]) for o in optics] + [[0.0], eta])

    def unpack(z):
        u = start + z * unit
        own = u[3 : 3 + 3 * each].reshape(3, each)
        return u[:3], [(o[:4].reshape(2, 2), o[4:6], o[6:].reshape(n, 3)) for o in own], u[-3], u[-2:]

    def residuals(z):
        play, own, angle, middle = unpack(z)
        out = [play / PRIORS["backlash"]]
        for (m_o, eta_o, poses), (i, j), b in zip(own, index, measured):
            out.append(((all_shown(kinematics, poses, i, j, m_o, eta_o) - b) / NOISE).ravel())
            out.append(((poses - goals + sides * play / 2) / sigma).ravel())
            beside = about.T @ m_o
            turned = np.arctan2(beside[1, 0] - beside[0, 1], beside[0, 0] + beside[1, 1])
            out += [[(turned - angle) / SHARED["angle_rad"]], (eta_o - middle) / SHARED["parcentric_m"]]
        for a, b, seen in links:
            out.append((linked(kinematics, own[a][2][0], own[b][2][0], own[a][:2], own[b][:2]) - seen) / LINK_NOISE)
        return np.concatenate(out)

    fit = least_squares(residuals, np.zeros(len(start)), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=100)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * np.outer(unit, unit)
    wanted = np.concatenate([np.arange(3)] + [3 + each * o + np.arange(6) for o in range(3)])
    play, own, _, _ = unpack(fit.x)
    stored = {
        "made_by": "make_cases.py, scipy.optimize.least_squares",
        "priors": {"kinematics": kinematics, "arrival": arrival, **PRIORS},
        "shared": {"kinematics": kinematics, "backlash": PRIORS["backlash"], **SHARED},
        "views": [
            {"optics": 0, "reported": {"x_m": r[:2].tolist(), "theta_rad": float(r[2])}, "approach": s, "arrived": [True] * 3}
            for r, s in views
        ],
        "pairs": [
            [{"fixed": i, "found": j, "centre_px": b[:2].tolist(), "angle_rad": float(b[2]), "covariance": np.diag(NOISE**2).tolist()} for i, j, b in seen]
            for seen in pairs
        ],
        "links": [{"fixed": a, "found": b, "seen": s.tolist(), "covariance": np.diag(LINK_NOISE**2).tolist()} for a, b, s in links],
        "numbers": np.concatenate([play] + [np.concatenate([o[0].ravel(), o[1]]) for o in own]).tolist(),
        "covariance": covariance[np.ix_(wanted, wanted)].ravel().tolist(),
    }
    text = json.dumps(stored)
    (Path(__file__).parent / f"case_{name}.json").write_text(text + "\n")
    print(name, sum(map(len, pairs)), "pairs, chi-square", 2 * fit.cost, fit.message)


if __name__ == "__main__":
    paper = np.array([[5.11e-9, 5.0471e-7], [5.1197e-7, -5.04e-9]])
    turned = rotation(2.1) @ np.array([[1.0, 0.01], [0.0, 1.005]]) * 0.4e-6
    hexapod, table = [0.15e-6, 0.15e-6, 3e-6], [0.3e-6, 0.3e-6, 2e-5]
    turns = [(8e-5, 1), (4e-3, 1), (0.1, 1), (0.05, -1), (0.0, -1), (-0.1, -1), (-0.05, 1), (0.0, 1)]
    case("hexapod", "moves_microscope", paper, np.array([0.12491, 0.00012]), np.array([5e-6, 2e-6, 2e-5]), hexapod, turns, 1, True)
    case("table", "specimen_rotation_on_top", turned, np.array([0.003, -0.002]), np.array([0.0, 20e-6, 5e-5]), table, turns, 2, False)
    case("xy", "specimen_xy_on_top", paper, np.zeros(2), np.array([2e-6, 1e-6, 0.0]), [0.3e-6, 0.3e-6, None], [], 3, False)
    together("together", "moves_microscope", paper, np.array([0.12491, 0.00012]), np.array([5e-6, 2e-6, 2e-5]), hexapod, turns, 4)
    together("together_table", "specimen_rotation_on_top", turned, np.array([0.003, -0.002]), np.array([0.0, 20e-6, 5e-5]), table, turns, 5)
