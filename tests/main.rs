//! All integration tests of the root package, in one binary.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the message")]

mod floors;
mod settings;
mod virtual_time;
