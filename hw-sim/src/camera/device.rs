//! The A3DP/1 server as a value: bytes, frames and time go in; bytes and exposures come out.

use std::collections::{BTreeMap, VecDeque};
use std::net::SocketAddr;

use crate::camera::a3dp::{FLAG_ERROR, FLAG_REPLY};
use crate::camera::bridge::{Bridge, Refusal, Step};
use crate::camera::connection::{Connection, Role, Sign};
use crate::camera::fields::{Str8, Str16};
use crate::camera::identity::caps;
use crate::camera::message::{Bye, Caps, ErrorReport, Message};
use crate::camera::optics::Optics;
use crate::camera::render::{Capture, Frame};
use crate::camera::script::Mark;
use crate::camera::trouble::CameraFault;
use crate::fault::Fault;

/// What a camera is built with.
#[derive(Clone, Debug)]
pub struct DeviceSettings {
    /// Lens set.
    pub optics: Optics,
    /// Seconds of the camera in one second of the clock; positive. Time-outs are not scaled.
    pub speed: f64,
    /// New each time the device starts.
    pub boot_id: u64,
    /// What goes wrong; faults of the robot are ignored.
    pub faults: Vec<Fault>,
}

/// What the camera wants done.
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceOutput {
    /// Bytes for a client.
    Bytes {
        /// Connection to send on.
        connection: u64,
        /// Whole frames.
        bytes: Vec<u8>,
    },
    /// End of a connection, once its bytes are sent.
    Close {
        /// Connection to close.
        connection: u64,
    },
    /// Exposure begins now: a frame of what the camera sees must be computed and given back under this job.
    Expose {
        /// Count of the acquisition.
        job: u64,
        /// Acquisition as the client names it.
        trigger_id: u64,
        /// Settings that shape the frame.
        capture: Capture,
    },
    /// Exposure ended.
    Exposed {
        /// Job given with [`DeviceOutput::Expose`].
        job: u64,
    },
    /// A client broke the protocol.
    Violation(String),
}

/// The simulated camera: a bridge with its device, and the clients connected to it.
#[derive(Clone, Debug)]
pub struct Device {
    pub(super) settings: DeviceSettings,
    pub(super) caps: Caps,
    pub(super) connections: BTreeMap<u64, Connection>,
    pub(super) bridge: Bridge,
    pub(super) session_count: u32,
    pub(super) boot_id: u64,
    /// Until when another controller counts as connected.
    pub(super) busy_until_ns: Option<u64>,
    outputs: VecDeque<DeviceOutput>,
}

impl Device {
    /// Camera that nobody is connected to.
    pub fn new(settings: DeviceSettings) -> Self {
        Self {
            caps: caps(&settings.optics),
            connections: BTreeMap::new(),
            bridge: Bridge::new(&settings.faults),
            session_count: 0,
            boot_id: settings.boot_id,
            busy_until_ns: None,
            settings,
            outputs: VecDeque::new(),
        }
    }

    /// A client connected.
    pub fn handle_connected(&mut self, now_ns: u64, connection: u64) {
        self.handle_wake(now_ns);
        self.connections.insert(connection, Connection::new(now_ns));
    }

    /// Where a client speaks from.
    pub fn handle_address(&mut self, connection: u64, address: SocketAddr) {
        if let Some(state) = self.connections.get_mut(&connection) {
            state.address = Some(address);
        }
    }

    /// A client's connection ended. On one over which nothing passes any more that goes unnoticed.
    pub fn handle_closed(&mut self, now_ns: u64, connection: u64) {
        self.handle_wake(now_ns);
        if self.connections.get(&connection).is_some_and(|state| !state.is_silent) {
            self.forget(connection);
            self.handle_wake(now_ns);
        }
    }

    /// Bytes came from a client.
    pub fn handle_bytes(&mut self, now_ns: u64, connection: u64, bytes: &[u8]) {
        self.handle_wake(now_ns);
        let Some(state) = self.connections.get_mut(&connection) else {
            return;
        };
        if state.is_silent {
            return;
        }
        state.handle_bytes(now_ns, bytes);
        while let Some(frame) = self.speaking(connection).and_then(|state| state.parser.poll_frame()) {
            match frame {
                Ok(frame) => self.take_frame(now_ns, connection, &frame),
                Err(error) => self.fail(connection, 0, error.code(), &error.to_string()),
            }
            self.advance(now_ns);
        }
    }

    /// The frame of a job is computed. One that nobody waits for any more is dropped.
    pub fn handle_frame(&mut self, now_ns: u64, job: u64, frame: Frame) {
        self.bridge.take_frame(job, frame);
        self.handle_wake(now_ns);
    }

    /// Time has passed: does everything that is due.
    pub fn handle_wake(&mut self, now_ns: u64) {
        self.advance(now_ns);
        for connection in self.connections.keys().copied().collect::<Vec<_>>() {
            while let Some(sign) = self
                .connections
                .get_mut(&connection)
                .and_then(|state| state.poll_sign(now_ns))
            {
                self.show_life(now_ns, connection, sign);
            }
        }
    }

    /// When [`Device::handle_wake`] has something to do.
    pub fn wake_at(&self) -> Option<u64> {
        let connections_ns = self.connections.values().map(Connection::wake_at);
        connections_ns.chain(self.bridge.wake_at()).min()
    }

    /// Next thing to do.
    pub fn poll_output(&mut self) -> Option<DeviceOutput> {
        self.outputs.pop_front()
    }

    /// Says good-bye to everyone.
    pub fn shut_down(&mut self) {
        for connection in self.connections.keys().copied().collect::<Vec<_>>() {
            self.bye(connection, BYE_SHUTTING_DOWN, "shutting down");
        }
    }

    /// Faults of triggers that have happened.
    pub fn met_faults(&self) -> Vec<CameraFault> {
        self.bridge.script().met().collect()
    }

    /// The bridge's time passes.
    pub(super) fn advance(&mut self, now_ns: u64) {
        while let Some(step) = self.bridge.poll_step(now_ns, &self.settings) {
            match step {
                Step::Send {
                    to,
                    request_id,
                    message,
                    mark,
                } => {
                    let flags = if request_id == 0 { 0 } else { FLAG_REPLY };
                    self.send_marked(to, request_id, flags, &message, mark);
                }
                Step::Chunk { to, chunk, mark } => {
                    let bytes = self
                        .connections
                        .get_mut(&to)
                        .and_then(|state| state.chunk_frame(&chunk, mark));
                    self.put_out(to, bytes);
                }
                Step::Error { to, refusal } => self.send_error(to, 0, &refusal),
                Step::Event(event) => self.tell_all(&Message::Event(event), |_| true),
                Step::Expose {
                    job,
                    trigger_id,
                    capture,
                } => self.outputs.push_back(DeviceOutput::Expose {
                    job,
                    trigger_id,
                    capture,
                }),
                Step::Exposed(job) => self.outputs.push_back(DeviceOutput::Exposed { job }),
                Step::FallSilent(connection) => {
                    if let Some(state) = self.connections.get_mut(&connection) {
                        state.is_silent = true;
                    }
                }
                Step::HangUp(connection) => self.close(connection),
                Step::Kick => self.shut_down(),
                Step::Restart => self.restart(),
            }
        }
    }

    fn show_life(&mut self, now_ns: u64, connection: u64, sign: Sign) {
        match sign {
            Sign::Status => {
                let status = self.bridge.status();
                self.send(connection, 0, 0, &status);
            }
            Sign::Ping(id) => self.send(connection, id, 0, &Message::Ping(now_ns)),
            // The end that nobody notices is only forgotten.
            Sign::Dead if self.connections[&connection].is_silent => self.forget(connection),
            Sign::Dead => self.bye(connection, BYE_TIME_OUT, "nothing heard"),
        }
    }

    fn restart(&mut self) {
        for connection in self.connections.keys().copied().collect::<Vec<_>>() {
            self.close(connection);
        }
        self.boot_id = self.boot_id.wrapping_add(1);
        self.bridge.restart();
    }

    fn speaking(&mut self, connection: u64) -> Option<&mut Connection> {
        self.connections.get_mut(&connection).filter(|state| !state.is_silent)
    }

    /// To everyone greeted whose role fits.
    pub(super) fn tell_all(&mut self, message: &Message, is_meant: fn(Role) -> bool) {
        let greeted = self
            .connections
            .iter()
            .filter(|(_, state)| state.role != Role::Stranger);
        let meant: Vec<u64> = greeted
            .filter(|(_, state)| is_meant(state.role))
            .map(|(connection, _)| *connection)
            .collect();
        for connection in meant {
            self.send(connection, 0, 0, message);
        }
    }

    /// A protocol error: ERROR, BYE, end.
    pub(super) fn fail(&mut self, connection: u64, request_id: u32, code: u16, text: &str) {
        self.outputs.push_back(DeviceOutput::Violation(format!(
            "a3dp connection {connection}: {code}: {text}"
        )));
        self.send_error(connection, request_id, &Refusal::new(code, text));
        self.bye(connection, BYE_PROTOCOL_ERROR, "protocol error");
    }

    pub(super) fn bye(&mut self, connection: u64, reason: u16, text: &str) {
        let text = Str8(text.to_owned());
        self.send(connection, 0, 0, &Message::Bye(Bye { reason, text }));
        self.close(connection);
    }

    pub(super) fn close(&mut self, connection: u64) {
        self.outputs.push_back(DeviceOutput::Close { connection });
        self.forget(connection);
    }

    fn forget(&mut self, connection: u64) {
        self.connections.remove(&connection);
        self.bridge.handle_gone(connection);
    }

    pub(super) fn send_error(&mut self, connection: u64, request_id: u32, refusal: &Refusal) {
        self.bridge.count_error(refusal.code);
        let error = Message::Error(ErrorReport {
            about_request_id: request_id,
            trigger_id: refusal.trigger_id,
            code: refusal.code,
            phase: refusal.phase,
            retryable: u8::from(refusal.is_retryable),
            retry_after_ms: refusal.retry_after_ms,
            vendor_code: refusal.vendor_code,
            text: Str16(refusal.text.clone()),
        });
        let reply = if request_id == 0 { 0 } else { FLAG_REPLY };
        self.send(connection, request_id, FLAG_ERROR | reply, &error);
    }

    pub(super) fn send(&mut self, connection: u64, request_id: u32, flags: u16, message: &Message) {
        self.send_marked(connection, request_id, flags, message, Mark::default());
    }

    fn send_marked(&mut self, connection: u64, request_id: u32, flags: u16, message: &Message, mark: Mark) {
        let bytes = self
            .connections
            .get_mut(&connection)
            .and_then(|state| state.frame(request_id, flags, message, mark));
        self.put_out(connection, bytes);
    }

    fn put_out(&mut self, connection: u64, bytes: Option<Vec<u8>>) {
        self.outputs
            .extend(bytes.map(|bytes| DeviceOutput::Bytes { connection, bytes }));
    }
}

pub(super) const BYE_PROTOCOL_ERROR: u16 = 3;
const BYE_SHUTTING_DOWN: u16 = 2;
const BYE_TIME_OUT: u16 = 4;

#[cfg(test)]
#[path = "device_tests/mod.rs"]
mod tests;
