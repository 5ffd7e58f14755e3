//! The vocabulary of space: clouds and rigid motions.

mod cloud;

pub use cloud::{Measured, PointCloud};
