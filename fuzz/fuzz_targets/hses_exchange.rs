//! A datagram for an open conversation.
#![no_main]
#![allow(dead_code, reason = "the other targets use the rest")]

#[path = "../../experiments/src/fuzz/hses.rs"]
mod hses;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    hses::exchange(bytes);
});
