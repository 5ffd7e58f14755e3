//! The structured-light camera: its optics, the frames it takes of a mesh, and how it speaks A3DP/1.

pub mod a3dp;
mod acquisition;
pub mod device;
pub mod fields;
mod identity;
pub mod message;
mod noise;
pub mod optics;
pub mod payload;
pub mod render;
mod session;
pub mod settings;
pub mod transfer;
