//! Simulated blade-scanning cell: a DX200 robot controller speaking HSES and a structured-light camera speaking A3DP/1.
//!
//! This crate is a second, independent reading of `docs/protocols/`; it names nothing of the controller crate.
//!
//! [`cell::Cell`] is the whole cell as a value: datagrams, bytes, finished render jobs and time go in; datagrams, bytes,
//! render jobs and the truth come out. Only [`shell`] opens sockets and reads a clock.

pub mod blade;
pub mod camera;
pub mod cell;
mod checks;
pub mod cli;
mod draws;
pub mod fault;
pub mod network;
pub mod pose_error;
pub mod robot;
pub mod scene;
pub mod score;
pub mod shell;
pub mod truth;
pub mod vendor;

#[cfg(test)]
mod test_client;
#[cfg(test)]
mod vectors;
