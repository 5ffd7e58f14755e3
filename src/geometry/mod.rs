//! The vocabulary of space: clouds and rigid motions.

mod cloud;
mod rigid;

pub use cloud::{Measured, PointCloud};
pub use rigid::{
    NotRigid, fixed_xyz_from_rotation, isometry_from_rows, matrix_rows, rotation_angle_between, rotation_from_fixed_xyz,
};
