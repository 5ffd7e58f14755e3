//! Open controller for automatic blade scanning.
//!
//! See `ARCHITECTURE.md` for the floors, the flow of one view and the invariants.

pub mod geometry;
pub mod plan;
pub mod reconstruction;
pub mod registration;
pub mod seed;
pub mod settings;
