//! The structured-light camera: its optics, the frames it takes of a mesh, and how it speaks A3DP/1.

pub mod a3dp;
pub mod device;
pub mod fields;
pub mod message;
mod noise;
pub mod optics;
pub mod payload;
pub mod render;
mod session;
pub mod settings;
pub mod transfer;
