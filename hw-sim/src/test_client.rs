//! The client's half of a camera connection, for tests.

use crate::camera::a3dp::{Parser, ProtocolError, RawFrame};
use crate::camera::fields::{Rest, Str8, Zero};
use crate::camera::message::{Arm, Hello, Message, Trigger};
use crate::camera::settings::Settings;
use crate::vectors::{CAMERA_PAGE, vector};

/// Writes requests and reads what comes back.
#[derive(Default)]
pub(crate) struct Client {
    parser: Parser,
    next_seq: u32,
    last_id: u32,
}

impl Client {
    /// Bytes of a request with the next id.
    pub(crate) fn request(&mut self, message: &Message) -> Vec<u8> {
        self.last_id += 1;
        self.frame(message.kind(), self.last_id, 0, message.to_payload())
    }

    /// Bytes of any frame, with the next count.
    pub(crate) fn frame(&mut self, kind: u16, request_id: u32, flags: u16, payload: Vec<u8>) -> Vec<u8> {
        let frame = RawFrame {
            kind,
            request_id,
            seq: self.next_seq,
            flags,
            payload,
        };
        self.next_seq += 1;
        frame.to_bytes()
    }

    /// Messages in bytes of the camera; every frame must be right.
    pub(crate) fn read(&mut self, bytes: &[u8]) -> Vec<(RawFrame, Message)> {
        self.try_read(bytes).into_iter().map(Result::unwrap).collect()
    }

    /// Messages in bytes of the camera, and what is wrong with the stream.
    pub(crate) fn try_read(&mut self, bytes: &[u8]) -> Vec<Result<(RawFrame, Message), ProtocolError>> {
        self.parser.handle_bytes(bytes);
        core::iter::from_fn(|| self.parser.poll_frame())
            .map(|frame| {
                let frame = frame?;
                let message = Message::read(frame.kind, &frame.payload).unwrap();
                Ok((frame, message))
            })
            .collect()
    }
}

pub(crate) fn hello() -> Message {
    hello_as(1, 1)
}

pub(crate) fn hello_as(role: u8, run_id: u64) -> Message {
    Message::Hello(Hello {
        min_version: [1, 0],
        max_version: [1, 0],
        role,
        reserved: Zero,
        run_id,
        client_name: Str8("test".to_owned()),
    })
}

/// The page's settings with a region of 80 × 40 pixels in the middle, unbinned.
pub(crate) fn small_settings() -> Settings {
    let mut settings = Settings::read(&vector(CAMERA_PAGE, "configure")[32..]).unwrap();
    settings.binning = 0;
    (settings.roi.width_px, settings.roi.height_px) = (80, 40);
    settings.roi.camera_1_px = [680, 520];
    settings.roi.camera_2_px = [680, 520];
    settings
}

pub(crate) fn configure(settings: &Settings) -> Message {
    Message::Configure(Rest(settings.to_records()))
}

pub(crate) fn arm(config_id: u32) -> Message {
    Message::Arm(Arm {
        mode: 1,
        reserved: Zero,
        config_id,
    })
}

pub(crate) fn trigger(trigger_id: u64, deadline_ms: u32) -> Message {
    Message::Trigger(Trigger {
        trigger_id,
        view_id: (trigger_id >> 16) as u32,
        config_id: 1,
        deadline_ms,
        tag: Str8::default(),
    })
}
