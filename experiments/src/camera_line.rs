//! The controller's connection to the simulated camera on virtual time: one at a time, and its bytes in pieces.

use bladescan::camera::CameraOutput;
use bladescan::controller::Input;
use hw_sim::cell;
use rand::RngExt;

/// The connection that stands, and how many there have been.
#[derive(Debug, Default)]
pub(crate) struct CameraLine {
    open: Option<u64>,
    count: u64,
}

/// What is on its way between both.
pub(crate) enum Passing {
    ToCamera(cell::Input),
    /// On the connection of this number, unless that has ended by then.
    FromCamera(u64, Input),
}

impl CameraLine {
    /// What the controller's output sets on its way, and how many latencies it takes. Without a connection nothing is but a
    /// new one.
    pub(crate) fn handle_output(&mut self, output: CameraOutput) -> Vec<(u64, Passing)> {
        let to_camera = |input| vec![(1, Passing::ToCamera(input))];
        match (output, self.open) {
            (CameraOutput::Connect, _) => {
                self.count += 1;
                let connection = self.count;
                self.open = Some(connection);
                let mut passing = to_camera(cell::Input::CameraConnected { connection });
                passing.push((2, Passing::FromCamera(connection, Input::CameraConnected)));
                passing
            }
            (CameraOutput::Bytes { bytes, .. }, Some(connection)) => {
                to_camera(cell::Input::CameraBytes { connection, bytes })
            }
            (CameraOutput::Close, Some(connection)) => {
                self.open = None;
                to_camera(cell::Input::CameraClosed { connection })
            }
            (CameraOutput::Bytes { .. } | CameraOutput::Close, None) => Vec::new(),
        }
    }

    /// Whether what comes on this connection is still heard; its end is the last of it.
    pub(crate) fn hears(&mut self, connection: u64, input: &Input) -> bool {
        let is_heard = self.open == Some(connection);
        if is_heard && matches!(input, Input::CameraClosed { .. }) {
            self.open = None;
        }
        is_heard
    }

    /// The controller is gone: the connection that stood.
    pub(crate) fn take(&mut self) -> Option<u64> {
        self.open.take()
    }
}

/// Bytes of the camera come in pieces as a stream's do: of drawn lengths, or whole where no length is the longest.
pub(crate) fn pieces<'a>(bytes: &'a [u8], bytes_max: usize, chance: &mut impl RngExt) -> Vec<&'a [u8]> {
    let mut pieces = Vec::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let longest = rest.len().min(bytes_max);
        let length = match bytes_max {
            usize::MAX => longest,
            _ => chance.random_range(1..=longest),
        };
        let (piece, behind) = rest.split_at(length);
        pieces.push(piece);
        rest = behind;
    }
    pieces
}
