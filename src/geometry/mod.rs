//! The vocabulary of space: clouds and rigid motions.

mod cloud;
mod formats;
pub mod nearest;
pub mod normals;
pub mod pcd;
pub mod ply;
pub mod sampling;
pub mod xyz;

pub use cloud::{Measured, PointCloud};
pub use formats::{FormatError, read_cloud};
