//! The simulated robot controller: a DX200 that speaks HSES.

pub mod controller;
pub mod host;
pub mod hses;
pub mod motion;
mod order;
pub mod pose;
