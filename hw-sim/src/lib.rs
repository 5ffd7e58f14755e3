//! Simulated blade-scanning cell: a DX200 robot controller speaking HSES and a structured-light camera speaking A3DP/1.
//!
//! This crate is a second, independent reading of `docs/protocols/`; it names nothing of the controller crate.

pub mod blade;
pub mod camera;
mod draws;
pub mod pose_error;
pub mod score;
pub mod truth;
