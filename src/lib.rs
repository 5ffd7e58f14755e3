//! Open controller for automatic blade scanning.
//!
//! See `ARCHITECTURE.md` for the floors, the flow of one view and the invariants.

pub mod camera;
pub mod cleaning;
pub mod cli;
pub mod controller;
pub mod event;
pub mod fault;
pub mod geometry;
pub mod job;
pub mod journal;
pub mod plan;
pub mod reconstruction;
pub mod registration;
pub mod robot;
pub mod run;
pub mod seed;
pub mod session;
pub mod settings;
pub mod stamp;
#[cfg(test)]
mod vectors;
