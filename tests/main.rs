//! All integration tests of the root package, in one binary.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the message")]

mod bridge;
mod camera;
mod camera_server;
mod cli;
mod conformance;
mod exposures;
mod faults;
mod floors;
mod provenance;
mod reconstruct;
mod register;
mod resume;
mod robot;
mod runs;
mod settings;
mod stations;
mod support;
mod two_readings;
mod virtual_time;
mod wire;
