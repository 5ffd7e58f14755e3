//! The vocabulary of space: clouds and rigid motions.

pub(crate) mod cells;
mod cloud;
mod formats;
pub mod grid;
pub mod nearest;
pub mod normals;
pub mod patches;
pub mod pcd;
pub mod ply;
mod rigid;
pub mod sampling;
pub mod simd;
pub mod statistics;
pub mod xyz;

pub use cloud::{Measured, PointCloud};
pub use formats::{FormatError, read_cloud};
pub use rigid::{
    NotRigid, fixed_xyz_from_rotation, isometry_from_rows, matrix_rows, rotation_angle_between, rotation_from_fixed_xyz,
};
