//! The structured-light camera: its optics, and the frames it takes of a mesh.

mod noise;
pub mod optics;
pub mod render;
