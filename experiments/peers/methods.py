"""Every way to register two clouds from the identity: programs of other hands, each as its documentation recommends.

A method takes source and target (n x 3) and what it is given, and gives the 4 x 4 motion target_from_source.
"""
from collections import namedtuple

import numpy as np
from scipy.spatial import cKDTree

import plain
from cases import matrix, motion

ICP_ITERATIONS = 200
EM_ITERATIONS = 150
OUTLIER_FRACTION = 0.1
# Shares of the target's size.
FIRST_REACH = 0.25
KISS_VOXEL = 0.015


# What a user knows: how many threads, and the spacing of the target's points.
Given = namedtuple("Given", "threads spacing")


def spacing(cloud):
    """Median distance to the nearest neighbour."""
    return np.median(cKDTree(cloud).query(cloud, k=2)[0][:, 1])


def scales(target, step):
    """Voxel size and reaches of correspondences, coarse to fine.

    Open3D's tutorial of multi-scale ICP: finer voxels step by step, a reach of some voxels. Here the first reach has to bridge
    what the identity leaves, and the last voxel is the spacing of the points. The very last reach is no more than that on dense
    views, and twice that on sparse clouds: what lies over the other view's rim pulls no more, which halves errors.
    """
    size = np.ptp(target, axis=0).max()
    coarse = [(0.02 * size, [FIRST_REACH * size]), (0.01 * size, [0.05 * size]), (0.005 * size, [0.02 * size])]
    last = step if is_dense(size, step) else 2 * step
    return [scale for scale in coarse if scale[0] > 1.5 * step] + [(step, [4 * step, last])]


def finer(scales):
    """What is left after a start has been found by features."""
    return scales[1:] or scales


def is_dense(size, step):
    """A camera's view rather than a few thousand points."""
    return 0.005 * size > 1.5 * step


def open3d_cloud(cloud):
    import open3d

    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud))


def open3d_icp(source, target, given):
    """Point to point over all points without a limit of distance: the textbook's ICP."""
    from open3d.pipelines import registration as o3d

    criteria = o3d.ICPConvergenceCriteria(1e-9, 1e-9, ICP_ITERATIONS)
    step = o3d.TransformationEstimationPointToPoint()
    reach = 1e3 * np.ptp(target, axis=0).max()
    clouds = open3d_cloud(source), open3d_cloud(target)
    return o3d.registration_icp(*clouds, reach, np.eye(4), step, criteria).transformation


def open3d_scale(kind, source, target, voxel, reaches, pose):
    """One scale of point to plane (the tutorial's 30 neighbours for a normal) or of generalized ICP (its default 20)."""
    from open3d.geometry import KDTreeSearchParamKNN
    from open3d.pipelines import registration as o3d

    source, target = source.voxel_down_sample(voxel), target.voxel_down_sample(voxel)
    criteria = o3d.ICPConvergenceCriteria(1e-7, 1e-7, 50)
    if kind == "plane":
        target.estimate_normals(KDTreeSearchParamKNN(30))
        step, register = o3d.TransformationEstimationPointToPlane(), o3d.registration_icp
    else:
        for cloud in (source, target):
            cloud.estimate_normals(KDTreeSearchParamKNN(20))
        step, register = o3d.TransformationEstimationForGeneralizedICP(), o3d.registration_generalized_icp
    for reach in reaches:
        pose = register(source, target, reach, pose, step, criteria).transformation
    return pose


def open3d_scales(kind):
    def register(source, target, given):
        clouds = open3d_cloud(source), open3d_cloud(target)
        pose = np.eye(4)
        for voxel, reaches in scales(target, given.spacing):
            pose = open3d_scale(kind, *clouds, voxel, reaches, pose)
        return pose

    return register


def open3d_fpfh_plane(source, target, given):
    """The tutorial of global registration with its ratios to the voxel, then point to plane as `open3d-plane` ends."""
    import open3d
    from open3d.geometry import KDTreeSearchParamHybrid as near
    from open3d.pipelines import registration as o3d

    voxel = max(0.03 * np.ptp(target, axis=0).max(), 1.5 * given.spacing)
    clouds = open3d_cloud(source), open3d_cloud(target)
    thin = [cloud.voxel_down_sample(voxel) for cloud in clouds]
    for cloud in thin:
        cloud.estimate_normals(near(2 * voxel, 30))
    features = [o3d.compute_fpfh_feature(cloud, near(5 * voxel, 100)) for cloud in thin]
    open3d.utility.random.seed(1)
    pose = o3d.registration_ransac_based_on_feature_matching(
        *thin,
        *features,
        True,
        1.5 * voxel,
        o3d.TransformationEstimationPointToPoint(False),
        3,
        [o3d.CorrespondenceCheckerBasedOnEdgeLength(0.9), o3d.CorrespondenceCheckerBasedOnDistance(1.5 * voxel)],
        o3d.RANSACConvergenceCriteria(100000, 0.999),
    ).transformation
    for voxel, reaches in finer(scales(target, given.spacing)):
        pose = open3d_scale("plane", *clouds, voxel, reaches, pose)
    return pose


def small_gicp_with(kind):
    """One scale over all points, with a reach of half the target."""

    def register(source, target, given):
        import small_gicp

        return small_gicp.align(
            target,
            source,
            registration_type=kind,
            downsampling_resolution=0.1 * given.spacing,
            max_correspondence_distance=0.5 * np.ptp(target, axis=0).max(),
            num_threads=given.threads,
            max_iterations=ICP_ITERATIONS,
        ).T_target_source

    return register


def small_gicp_scale(source, target, voxel, reaches, pose, threads):
    """The package's own preprocessing, 20 neighbours as its C++ default; ends tighter than a lidar needs."""
    import small_gicp

    target, tree = small_gicp.preprocess_points(target, voxel, 20, threads)
    source, _ = small_gicp.preprocess_points(source, voxel, 20, threads)
    limits = {"max_iterations": 100, "rotation_epsilon": 1e-6, "translation_epsilon": 1e-4 * voxel, "num_threads": threads}
    for reach in reaches:
        pose = small_gicp.align(
            target, source, tree, pose, registration_type="GICP", max_correspondence_distance=reach, **limits
        ).T_target_source
    return pose


def small_gicp_scales(source, target, given):
    pose = np.eye(4)
    for voxel, reaches in scales(target, given.spacing):
        pose = small_gicp_scale(source, target, voxel, reaches, pose, given.threads)
    return pose


def kiss_matcher_alone(source, target, given):
    """All settings follow from the voxel, as in the package's own examples; of 1 to 4 % of the size, 1.5 was the best here."""
    import kiss_matcher

    # The least noise it assumes by default is meant for metres and would be as large as a blade here.
    voxel = max(KISS_VOXEL * np.ptp(target, axis=0).max(), 2.0 * given.spacing)
    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(voxel, enable_noise_bound_clamping=False))
    found = matcher.estimate(source.astype(np.float32), target.astype(np.float32))
    return matrix(np.asarray(found.rotation), np.asarray(found.translation))


def kiss_gicp(source, target, given):
    """KISS-Matcher for the start and small_gicp for the rest, as its authors combine the two."""
    pose = kiss_matcher_alone(source, target, given)
    for voxel, reaches in finer(scales(target, given.spacing)):
        pose = small_gicp_scale(source, target, voxel, reaches, pose, given.threads)
    return pose


def probreg_filterreg(source, target, given):
    """Dense clouds thinned to voxels of 2 % of their size, as the package's examples do; all of them take a minute."""
    from probreg import filterreg

    size = np.ptp(target, axis=0).max()
    clouds = open3d_cloud(source), open3d_cloud(target)
    if is_dense(size, given.spacing):
        clouds = [cloud.voxel_down_sample(0.02 * size) for cloud in clouds]
    found = filterreg.registration_filterreg(*clouds, update_sigma2=True, w=OUTLIER_FRACTION, maxiter=EM_ITERATIONS)
    return motion(source, np.asarray(found.transformation.transform(source)))


def pycpd_rigid(source, target, given):
    """In the unit that the authors' program brings the target to; pycpd leaves that to its caller."""
    from pycpd import RigidRegistration

    class FixedScale(RigidRegistration):
        """The package always finds a scale too; with 1 instead, translation and variance are others."""

        def update_transform(self):
            super().update_transform()
            self.s = 1.0
            self.t = (self.P.sum(0) @ self.X - (self.P.sum(1) @ self.Y) @ self.R) / self.Np

        def update_variance(self):
            super().update_variance()
            squared = self.Pt1 @ (self.X_hat**2).sum(1) - 2 * np.trace(self.A @ self.R) + self.YPY
            self.sigma2 = max(squared / (self.Np * self.D), np.finfo(float).eps)

    unit = np.sqrt(((target - target.mean(0)) ** 2).sum(1).mean())
    moved, _ = FixedScale(
        X=target / unit, Y=source / unit, w=OUTLIER_FRACTION, max_iterations=EM_ITERATIONS
    ).register()
    return motion(source, moved * unit)


METHODS = {
    "open3d-icp": open3d_icp,
    "open3d-plane": open3d_scales("plane"),
    "open3d-gicp": open3d_scales("gicp"),
    "open3d-fpfh-plane": open3d_fpfh_plane,
    "small-gicp": small_gicp_with("GICP"),
    "small-icp": small_gicp_with("ICP"),
    "small-gicp-scales": small_gicp_scales,
    "kiss-matcher": kiss_matcher_alone,
    "kiss-gicp": kiss_gicp,
    "probreg-filterreg": probreg_filterreg,
    "pycpd": pycpd_rigid,
    "own-tricp": plain.tricp,
    "own-bcpd": plain.bcpd,
}
