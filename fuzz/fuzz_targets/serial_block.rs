//! Bytes of the serial line, read as blocks.
#![no_main]
#![allow(dead_code, reason = "the other targets use the rest")]

#[path = "../../experiments/src/fuzz/host.rs"]
mod host;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    host::block(bytes);
});
