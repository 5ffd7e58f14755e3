"""Methods of which there is no package, written here plainly and with all pairs in memory: a second reading of their papers."""
import numpy as np
from scipy.spatial import cKDTree

from cases import matrix, motion, placed

OUTLIER_FRACTION = 0.1
GOLDEN = 0.6180339887498948


def tricp(source, target, given):
    """Trimmed ICP with the overlap by golden section (Chetverikov et al. 2005)."""
    tree = cKDTree(target)

    def run(overlap):
        pose, last, kept = np.eye(4), np.inf, max(3, round(overlap * len(source)))
        for _ in range(100):
            distances, partners = tree.query(placed(source, pose), workers=given.threads)
            order = np.argsort(distances, kind="stable")[:kept]
            error = (distances[order] ** 2).mean()
            if abs(last - error) <= 1e-4 * error:
                break
            last = error
            pose = motion(source[order], target[partners[order]])
        return last / overlap**3, pose

    low, high = 0.4, 1.0
    runs = [run(high)]
    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    of_left, of_right = run(left), run(right)
    while high - low > 0.02:
        runs += [of_left, of_right]
        if of_left[0] < of_right[0]:
            high, right, of_right = right, left, of_left
            left = high - GOLDEN * (high - low)
            of_left = run(left)
        else:
            low, left, of_left = left, right, of_right
            right = low + GOLDEN * (high - low)
            of_right = run(right)
    return min(runs + [of_left, of_right], key=lambda found: found[0])[1]


def bcpd(source, target, given):
    """Rigid BCPD (Hirose 2021) with infinite lambda and kappa, omega 0.1, gamma 1, ended as the published program ends."""
    unit = np.sqrt(((source - source.mean(0)) ** 2).mean())
    x, y = (target - source.mean(0)) / unit, (source - source.mean(0)) / unit
    volume = np.prod(np.ptp(x, axis=0) * (len(x) + 1) / len(x))
    sigma = np.sqrt(((x**2).sum() * len(y) + (y**2).sum() * len(x) - 2 * x.sum(0) @ y.sum(0)) / (len(x) * len(y) * 3))
    pose = np.eye(4)
    for iteration in range(500):
        here = placed(y, pose)
        squared = (x**2).sum(1)[:, None] + (here**2).sum(1)[None, :] - 2 * x @ here.T
        share = np.exp(-np.maximum(squared, 0) / (2 * sigma**2)) / len(y)
        outlier = (2 * np.pi * sigma**2) ** 1.5 * OUTLIER_FRACTION / (volume * (1 - OUTLIER_FRACTION))
        share /= share.sum(1, keepdims=True) + outlier
        weights, of_x = np.maximum(share.sum(0), 1e-20), share.sum(1)
        matched = share.T @ x / weights[:, None]
        mean_x, mean_y = weights @ matched / weights.sum(), weights @ y / weights.sum()
        u, _, vt = np.linalg.svd((weights[:, None] * (matched - mean_x)).T @ (y - mean_y))
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        pose = matrix(rotation, mean_x - rotation @ mean_y)
        here = placed(y, pose)
        total = of_x @ (x**2).sum(1) + weights @ (here**2).sum(1) - 2 * (weights[:, None] * matched * here).sum()
        last, sigma = sigma, np.sqrt(max(0.0, total / (3 * weights.sum())))
        if iteration > 30 and (sigma < 1e-4 or abs(last - sigma) < 1e-4):
            break
    return motion(source, placed(y, pose) * unit + source.mean(0))
