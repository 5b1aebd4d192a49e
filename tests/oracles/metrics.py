"""The pose metrics as their definitions read, in plain NumPy and without regard for speed.

One pose at a time: ``R`` is ``(3, 3)``, ``t`` is ``(3,)``, ``points`` is ``(V, 3)``; symmetries are
``(S, 4, 4)`` with the identity.
"""

import numpy as np


def transform(R, t, points):
    return points @ R.T + t


def translation_error(t_est, t_gt):
    return np.sqrt(np.sum((t_est - t_gt) ** 2))


def npe(t_est, t_gt):
    return translation_error(t_est, t_gt) / np.sqrt(np.sum(t_gt**2))


def orientation_error(R_est, R_gt):
    """From the sine and the cosine of the angle, exact at both ends."""
    d = R_est.T @ R_gt
    sine = np.linalg.norm([d[2, 1] - d[1, 2], d[0, 2] - d[2, 0], d[1, 0] - d[0, 1]])
    return np.arctan2(sine, np.trace(d) - 1.0)


def symmetric_orientation_error(R_est, R_gt, symmetries):
    return min(orientation_error(R_est, R_gt @ s[:3, :3]) for s in symmetries)


def add(points, R_est, t_est, R_gt, t_gt):
    difference = transform(R_est, t_est, points) - transform(R_gt, t_gt, points)
    return np.linalg.norm(difference, axis=1).mean()


def adds(points, R_est, t_est, R_gt, t_gt):
    est, gt = transform(R_est, t_est, points), transform(R_gt, t_gt, points)
    return np.linalg.norm(gt[:, None] - est[None], axis=2).min(axis=1).mean()


def _symmetric(gt, symmetries, points):
    for s in symmetries:
        yield transform(*gt, transform(s[:3, :3], s[:3, 3], points))


def mssd(points, R_est, t_est, R_gt, t_gt, symmetries):
    est = transform(R_est, t_est, points)
    return min(
        np.linalg.norm(est - gt, axis=1).max()
        for gt in _symmetric((R_gt, t_gt), symmetries, points)
    )


def project(K, points):
    uvw = points @ K.T
    return uvw[:, :2] / uvw[:, 2:]


def mspd(points, R_est, t_est, R_gt, t_gt, K, symmetries):
    est = project(K, transform(R_est, t_est, points))
    return min(
        np.linalg.norm(est - project(K, gt), axis=1).max()
        for gt in _symmetric((R_gt, t_gt), symmetries, points)
    )


def projection_error(points, R_est, t_est, R_gt, t_gt, K):
    est, gt = transform(R_est, t_est, points), transform(R_gt, t_gt, points)
    return np.linalg.norm(project(K, est) - project(K, gt), axis=1).mean()


def auc_exact(errors, max_error, n):
    """The step curve of recall, summed rectangle by rectangle."""
    d = np.sort(errors[errors <= max_error])
    edges = np.concatenate([d, [max_error]])
    return sum((k + 1) / n * (edges[k + 1] - edges[k]) for k in range(len(d))) / max_error


def auc_ycb(errors, max_error, n):
    """``VOCap`` of the YCB-Video tool box, line by line."""
    d = np.sort(np.where(errors > max_error, np.inf, errors))
    accuracy = np.cumsum(np.ones(len(d))) / n
    finite = np.isfinite(d)
    if not finite.any():
        return 0.0
    recall, precision = d[finite], accuracy[finite]
    mrec = np.concatenate([[0.0], recall, [max_error]])
    mpre = np.concatenate([[0.0], precision, [precision[-1]]])
    for i in range(1, len(mpre)):
        mpre[i] = max(mpre[i], mpre[i - 1])
    changed = np.flatnonzero(mrec[1:] != mrec[:-1]) + 1
    return np.sum((mrec[changed] - mrec[changed - 1]) * mpre[changed]) / max_error
