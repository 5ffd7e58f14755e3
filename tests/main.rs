//! All integration tests of the root package, in one binary.

mod cli;
mod faults;
mod runs;
mod settings;
mod support;
