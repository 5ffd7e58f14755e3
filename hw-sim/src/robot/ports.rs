//! The controller and everything it is reached through: HSES datagrams, host-control connections, the serial line, and the
//! network before them, as one value.
//!
//! Whatever passes goes through a [`Network`] of its own, in either direction, so that a test on virtual time and the shell
//! with its sockets meet the same faults.

use core::net::SocketAddr;
use std::collections::{BTreeMap, VecDeque};

use crate::fault::Fault;
use crate::network::{Carriage, Delivery, Network, NetworkFaults};
use crate::robot::controller::{Controller, Panel, RobotOutput, Settings};
use crate::robot::host::bsc::Timing;
use crate::robot::host::interpreter::interpret;
use crate::robot::host::serial::{Serial, SerialOutput};
use crate::robot::host::tcp::{Connection, TcpOutput};
use crate::robot::hses::Port;

/// How the links are built.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkOptions {
    /// Least time between the confirmation of a host-control command and its answer, ns, whatever the speed of the simulation.
    pub host_pause_ns: u64,
    /// Speed of the serial line; none for one that takes no time. The speed of the simulation makes it faster, never slower.
    pub serial_baud: Option<u32>,
    /// Time-outs and retries of the serial line.
    pub serial_timing: Timing,
}

impl Default for LinkOptions {
    /// 50 ms, for the public clients that read once for each line; 9600 baud; the DX100's time-outs.
    fn default() -> Self {
        Self {
            host_pause_ns: 50_000_000,
            serial_baud: Some(9600),
            serial_timing: Timing::default(),
        }
    }
}

/// What happens at the controller's ports.
#[derive(Clone, Debug)]
pub enum PortInput {
    /// A datagram for a port of HSES.
    Datagram {
        /// Which of them.
        port: Port,
        /// Sender; its answer goes there.
        from: SocketAddr,
        /// Whole datagram.
        bytes: Vec<u8>,
    },
    /// A client connected to host control.
    Connected {
        /// New for each connection.
        connection: u64,
    },
    /// Bytes for host control.
    Bytes {
        /// Connection they came on.
        connection: u64,
        /// Whatever piece of the stream came.
        bytes: Vec<u8>,
    },
    /// A client's connection to host control ended.
    Closed {
        /// Connection that ended.
        connection: u64,
    },
    /// Bytes on the serial line.
    Serial(Vec<u8>),
    /// A person does something at the controller's panel.
    Panel(Panel),
    /// Time has passed.
    Wake,
}

/// What the controller's ports want done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortOutput {
    /// An answer of HSES.
    Datagram {
        /// Port that it comes from.
        port: Port,
        /// Receiver.
        to: SocketAddr,
        /// Whole datagram.
        bytes: Vec<u8>,
    },
    /// Bytes of host control, as one segment.
    Bytes {
        /// Connection to send on.
        connection: u64,
        /// Piece of the stream.
        bytes: Vec<u8>,
    },
    /// End of a connection to host control, once its bytes are sent.
    Close {
        /// Connection to close.
        connection: u64,
    },
    /// Bytes for the serial line.
    Serial(Vec<u8>),
    /// Someone broke a protocol; for the log.
    Violation(String),
}

/// A character that has come over the serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passed {
    /// When the last of its bits came, ns.
    pub at_ns: u64,
    /// Whose it is.
    pub from: LineEnd,
    /// What it is.
    pub byte: u8,
}

/// An end of the serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineEnd {
    /// Our client's.
    Host,
    /// The controller's.
    Robot,
}

/// The controller behind its ports.
#[derive(Clone, Debug)]
pub struct Ports {
    controller: Controller,
    options: LinkOptions,
    faults: NetworkFaults,
    stall_moves: Vec<u32>,
    seed: u64,
    robot_datagrams: Ways,
    file_datagrams: Ways,
    serial: Serial,
    serial_ways: Ways,
    character_ns: u64,
    /// What came over the serial line, where somebody watches it.
    passed: Option<VecDeque<Passed>>,
    streams: BTreeMap<u64, Stream>,
    /// On its way, in the order of arrival; of equal times the earlier sent first.
    under_way: BTreeMap<(u64, u64), Arrival>,
    sent_count: u64,
    stalled_until_ns: u64,
    known_move_count: u32,
    outputs: VecDeque<PortOutput>,
}

/// Both ways of one path.
#[derive(Clone, Debug)]
struct Ways {
    to_robot: Network,
    to_client: Network,
}

#[derive(Clone, Debug)]
struct Stream {
    connection: Connection,
    ways: Ways,
}

/// What arrives at its end of the network.
#[derive(Clone, Debug)]
enum Arrival {
    AtRobot(PortInput),
    AtClient(PortOutput),
}

impl Ports {
    /// Controller just switched on, to which nobody is connected.
    pub fn new(settings: Settings, options: LinkOptions) -> Self {
        let faults = NetworkFaults::among(&settings.faults);
        let character_ns = options.serial_baud.map_or(0, |baud| {
            let bit_ns = 1e9 / f64::from(baud.max(1)) / settings.speed.max(1.0);
            (bit_ns * CHARACTER_BITS).round() as u64
        });
        let stall_moves = settings.faults.iter().filter_map(|fault| match fault {
            Fault::Stall { view } => Some(*view),
            _ => None,
        });
        Self {
            stall_moves: stall_moves.collect(),
            seed: settings.seed,
            robot_datagrams: Ways::new(faults, Carriage::Datagrams, settings.seed, PATH_ROBOT_DATAGRAMS),
            file_datagrams: Ways::new(faults, Carriage::Datagrams, settings.seed, PATH_FILE_DATAGRAMS),
            serial: Serial::new(options.serial_timing),
            serial_ways: Ways::new(faults, Carriage::Characters(character_ns), settings.seed, PATH_SERIAL),
            character_ns,
            passed: None,
            streams: BTreeMap::new(),
            under_way: BTreeMap::new(),
            sent_count: 0,
            stalled_until_ns: 0,
            known_move_count: 0,
            outputs: VecDeque::new(),
            controller: Controller::new(settings),
            options,
            faults,
        }
    }

    /// The controller itself.
    pub fn controller(&mut self) -> &mut Controller {
        &mut self.controller
    }

    /// Takes what happened at this time; times never go back. What was due before it happens first.
    pub fn handle_input(&mut self, now_ns: u64, input: PortInput) {
        self.advance(now_ns);
        match input {
            PortInput::Panel(panel) => self.controller.handle_panel(now_ns, panel),
            PortInput::Wake => (),
            PortInput::Datagram { port, from, bytes } => {
                for Delivery { at_ns, bytes } in self.datagrams(port).to_robot.push(now_ns, bytes) {
                    self.send(at_ns, Arrival::AtRobot(PortInput::Datagram { port, from, bytes }));
                }
            }
            PortInput::Serial(bytes) => {
                for Delivery { at_ns, bytes } in self.serial_ways.to_robot.push(now_ns, bytes) {
                    self.send(at_ns, Arrival::AtRobot(PortInput::Serial(bytes)));
                }
            }
            PortInput::Connected { connection } => self.connect(connection),
            PortInput::Bytes { connection, bytes } => {
                let piece = |bytes| PortInput::Bytes { connection, bytes };
                self.push_stream(now_ns, connection, bytes, piece);
            }
            PortInput::Closed { connection } => {
                self.push_stream(now_ns, connection, Vec::new(), |_| PortInput::Closed { connection });
            }
        }
        self.advance(now_ns);
    }

    /// Next thing to do.
    pub fn poll_output(&mut self) -> Option<PortOutput> {
        self.outputs.pop_front()
    }

    /// From here on [`Ports::poll_passed`] tells what comes over the serial line.
    pub fn watch_serial(&mut self) {
        self.passed.get_or_insert_default();
    }

    /// Next character that has come over the serial line. Times are those of the line, however late the caller is.
    pub fn poll_passed(&mut self) -> Option<Passed> {
        self.passed.as_mut()?.pop_front()
    }

    /// When [`PortInput::Wake`] has something to do.
    pub fn wake_at(&self) -> Option<u64> {
        let arrival_ns = self.under_way.keys().next().map(|(at_ns, _)| *at_ns);
        let stream_ns = self.streams.values().filter_map(|stream| stream.connection.wake_at());
        arrival_ns
            .into_iter()
            .chain(self.serial.wake_at())
            .chain(self.controller.wake_at())
            .chain(stream_ns)
            .min()
    }

    /// Lets everything happen that is due, in the order of time; at one time arrivals first.
    fn advance(&mut self, now_ns: u64) {
        while let Some(at_ns) = self.wake_at().filter(|at_ns| *at_ns <= now_ns) {
            let first = self.under_way.first_entry();
            match first.filter(|first| first.key().0 == at_ns).map(|first| first.remove()) {
                Some(Arrival::AtRobot(input)) => {
                    if let PortInput::Serial(bytes) = &input {
                        self.note(at_ns, LineEnd::Host, bytes);
                    }
                    self.take(at_ns, input);
                }
                Some(Arrival::AtClient(output)) => {
                    if let PortOutput::Serial(bytes) = &output {
                        self.note(at_ns, LineEnd::Robot, bytes);
                    }
                    self.outputs.push_back(output);
                }
                None => self.wake(at_ns),
            }
        }
    }

    /// Notes the characters of a piece whose last one came at this time.
    fn note(&mut self, last_ns: u64, from: LineEnd, bytes: &[u8]) {
        let Some(passed) = &mut self.passed else { return };
        for (left, byte) in (0..bytes.len() as u64).rev().zip(bytes) {
            passed.push_back(Passed {
                at_ns: last_ns.saturating_sub(left * self.character_ns),
                from,
                byte: *byte,
            });
        }
    }

    /// What arrives at the controller.
    fn take(&mut self, now_ns: u64, input: PortInput) {
        match input {
            PortInput::Datagram { port, from, bytes } => self.controller.handle_datagram(now_ns, port, from, &bytes),
            PortInput::Serial(bytes) => self.serial.handle_bytes(now_ns, &bytes, &mut self.controller),
            PortInput::Bytes { connection, bytes } => {
                if let Some(stream) = self.streams.get_mut(&connection) {
                    let controller = &mut self.controller;
                    stream
                        .connection
                        .handle_bytes(now_ns, &bytes, &mut |at_ns, call| interpret(controller, at_ns, call));
                }
            }
            PortInput::Closed { connection } => {
                self.streams.remove(&connection);
            }
            PortInput::Connected { .. } | PortInput::Panel(_) | PortInput::Wake => (),
        }
        self.put_out(now_ns);
    }

    /// What is due at the links.
    fn wake(&mut self, now_ns: u64) {
        self.controller.handle_wake(now_ns);
        self.serial.handle_wake(now_ns, &mut self.controller);
        let controller = &mut self.controller;
        for stream in self.streams.values_mut() {
            stream
                .connection
                .handle_wake(now_ns, &mut |at_ns, call| interpret(controller, at_ns, call));
        }
        self.put_out(now_ns);
    }

    fn datagrams(&mut self, port: Port) -> &mut Ways {
        match port {
            Port::Robot => &mut self.robot_datagrams,
            Port::File => &mut self.file_datagrams,
        }
    }

    fn connect(&mut self, connection: u64) {
        if self.streams.len() >= CONNECTION_COUNT_MAX {
            let bytes = b"NG: too many connections\r\n".to_vec();
            self.outputs.push_back(PortOutput::Bytes { connection, bytes });
            self.outputs.push_back(PortOutput::Close { connection });
            return;
        }
        let path = PATH_STREAMS + connection;
        let mut ways = Ways::new(self.faults, Carriage::Stream, self.seed, path);
        ways.stall(self.stalled_until_ns);
        let stream = Stream {
            connection: Connection::new(self.options.host_pause_ns),
            ways,
        };
        self.streams.insert(connection, stream);
    }

    /// Sends a piece of a stream to the controller; the end of a stream is an empty piece behind the others.
    fn push_stream(&mut self, now_ns: u64, connection: u64, bytes: Vec<u8>, input: impl Fn(Vec<u8>) -> PortInput) {
        let Some(stream) = self.streams.get_mut(&connection) else {
            return;
        };
        for Delivery { at_ns, bytes } in stream.ways.to_robot.push(now_ns, bytes) {
            self.send(at_ns, Arrival::AtRobot(input(bytes)));
        }
    }

    /// Sends what controller and links have to say. A silent controller says nothing on any link.
    fn put_out(&mut self, now_ns: u64) {
        self.stall(now_ns);
        let is_silent = self.controller.is_silent();
        while let Some(output) = self.controller.poll_output() {
            match output {
                RobotOutput::Datagram { port, to, bytes } => {
                    for Delivery { at_ns, bytes } in self.datagrams(port).to_client.push(now_ns, bytes) {
                        self.send(at_ns, Arrival::AtClient(PortOutput::Datagram { port, to, bytes }));
                    }
                }
                RobotOutput::Violation(text) => self.outputs.push_back(PortOutput::Violation(text)),
            }
        }
        while let Some(output) = self.serial.poll_output() {
            match output {
                SerialOutput::Bytes(_) if is_silent => (),
                SerialOutput::Bytes(bytes) => {
                    for Delivery { at_ns, bytes } in self.serial_ways.to_client.push(now_ns, bytes) {
                        self.send(at_ns, Arrival::AtClient(PortOutput::Serial(bytes)));
                    }
                }
                SerialOutput::Violation(what) => self.violation(format!("serial line: {what}")),
            }
        }
        let connections: Vec<u64> = self.streams.keys().copied().collect();
        for connection in connections {
            self.put_out_stream(now_ns, connection, is_silent);
        }
    }

    fn put_out_stream(&mut self, now_ns: u64, connection: u64, is_silent: bool) {
        while let Some(stream) = self.streams.get_mut(&connection)
            && let Some(output) = stream.connection.poll_output()
        {
            let (bytes, is_end) = match output {
                TcpOutput::Violation(what) => {
                    self.violation(format!("host control, connection {connection}: {what}"));
                    continue;
                }
                _ if is_silent => continue,
                TcpOutput::Bytes(bytes) => (bytes, false),
                TcpOutput::Close => (Vec::new(), true),
            };
            for Delivery { at_ns, bytes } in stream.ways.to_client.push(now_ns, bytes) {
                let output = if is_end {
                    PortOutput::Close { connection }
                } else {
                    PortOutput::Bytes { connection, bytes }
                };
                self.send(at_ns, Arrival::AtClient(output));
            }
            if is_end {
                self.streams.remove(&connection);
            }
        }
    }

    /// Stops the network for a while when a move has begun that a fault names.
    fn stall(&mut self, now_ns: u64) {
        let known = std::mem::replace(&mut self.known_move_count, self.controller.accepted_move_count());
        let begun = known..self.known_move_count;
        if !self.stall_moves.iter().any(|view| begun.contains(view)) {
            return;
        }
        self.stalled_until_ns = now_ns + STALL_NS;
        let streams = self.streams.values_mut().map(|stream| &mut stream.ways);
        let others = [
            &mut self.robot_datagrams,
            &mut self.file_datagrams,
            &mut self.serial_ways,
        ];
        for ways in streams.chain(others) {
            ways.stall(self.stalled_until_ns);
        }
    }

    fn send(&mut self, at_ns: u64, arrival: Arrival) {
        self.under_way.insert((at_ns, self.sent_count), arrival);
        self.sent_count += 1;
    }

    fn violation(&mut self, text: String) {
        self.outputs.push_back(PortOutput::Violation(text));
    }
}

impl Ways {
    fn new(faults: NetworkFaults, carriage: Carriage, seed: u64, path: u64) -> Self {
        Self {
            to_robot: Network::new(faults, carriage, seed, 2 * path),
            to_client: Network::new(faults, carriage, seed, 2 * path + 1),
        }
    }

    fn stall(&mut self, until_ns: u64) {
        self.to_robot.stall(until_ns);
        self.to_client.stall(until_ns);
    }
}

/// Host-control connections at once; how many a DX200 takes is unknown.
const CONNECTION_COUNT_MAX: usize = 8;
/// How long [`Fault::Stall`] lasts.
const STALL_NS: u64 = 2_000_000_000;
const PATH_ROBOT_DATAGRAMS: u64 = 0;
const PATH_FILE_DATAGRAMS: u64 = 1;
const PATH_SERIAL: u64 = 2;
const PATH_STREAMS: u64 = 3;
/// Start bit, eight data bits, even parity, stop bit.
const CHARACTER_BITS: f64 = 11.0;

#[cfg(test)]
#[path = "ports_tests.rs"]
mod tests;
