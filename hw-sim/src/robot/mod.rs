//! The simulated robot controller: a DX200.
//!
//! [`controller::Controller`] is the whole of it as a value. Its methods are what a client can do, with plain arguments;
//! the protocols only read and write bytes.

pub mod alarms;
pub mod axes;
pub mod controller;
pub mod files;
pub mod hses;
pub mod io;
pub mod job;
pub mod motion;
pub mod moves;
pub mod panel;
pub mod pose;
pub mod refused;
pub mod settings;
pub mod status;
mod store;
pub mod switches;
pub mod variables;

#[cfg(test)]
mod state_tests;
