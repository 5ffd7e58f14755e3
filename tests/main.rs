//! All integration tests of the root package, in one binary.

mod faults;
mod runs;
mod settings;
mod support;
