//! A stream of camera frames: messages of either side, frames of points, put together and cleaned.
#![no_main]
#![allow(dead_code, reason = "the seeds are for the other harness")]

#[path = "../../experiments/src/fuzz/camera.rs"]
mod camera;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut mended = bytes.to_vec();
    camera::mend_frames(&mut mended);
    camera::frames(bytes);
    camera::frames(&mended);
    camera::points(bytes);
});
