//! Sockets, the clock and the threads around a [`Cell`]: the one place of the simulator that does I/O while it runs.

use std::collections::BTreeMap;
use std::future::Future;
use std::io::{self, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use thiserror::Error;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use crate::camera::render::{Frame, Renderer};
use crate::cell::{Cell, Input, Output, RenderJob};
use crate::robot::hses::Port;
use crate::robot::ports::{Passed, PortInput, PortOutput};
use crate::truth::Truth;

mod serial_line;

use serial_line::{SerialLine, ServedLine};

/// What a cell is to be reached through; a port of 0 is any free one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// UDP port of the robot's HSES.
    pub hses: Option<u16>,
    /// UDP port of the robot's HSES for files.
    pub hses_file: Option<u16>,
    /// TCP port of the robot's host control.
    pub host_control: Option<u16>,
    /// Whether the robot has a serial line, as a pseudo-terminal.
    pub has_serial: bool,
    /// TCP port of the camera.
    pub camera: Option<u16>,
}

/// Sockets of a cell on the loopback interface, and its serial line; what is not wanted is not there.
#[derive(Debug)]
pub struct Sockets {
    robot: Option<UdpSocket>,
    robot_file: Option<UdpSocket>,
    host_control: Option<TcpListener>,
    serial: Option<SerialLine>,
    camera: Option<TcpListener>,
}

/// What a watcher of a cell sees.
#[derive(Clone, Copy, Debug)]
pub enum Seen<'a> {
    /// What comes from outside, before the cell has it.
    Input(&'a Input),
    /// A character that has come over the serial line, to either end.
    Passed(Passed),
}

/// Why a cell cannot serve.
#[derive(Debug, Error)]
pub enum ShellError {
    /// The port is taken, or may not be opened.
    #[error("cannot listen on 127.0.0.1:{port} ({transport}): {source}")]
    Listen {
        /// UDP or TCP.
        transport: &'static str,
        /// Port asked for.
        port: u16,
        /// What the system says.
        source: io::Error,
    },
    /// No pseudo-terminal can be had.
    #[error("cannot open a pseudo-terminal for the serial line: {0}")]
    Serial(#[from] tokio_serial::Error),
    /// A socket failed while serving.
    #[error("the {device} socket failed: {source}")]
    Socket {
        /// Robot or camera.
        device: &'static str,
        /// What the system says.
        source: io::Error,
    },
    /// The truth cannot be written.
    #[error("cannot write {path}: {source}")]
    Truth {
        /// File.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

impl Sockets {
    /// Opens what is wanted.
    pub async fn open(wanted: &Wanted) -> Result<Self, ShellError> {
        let robot = match wanted.hses {
            Some(port) => Some(bind(port).await?),
            None => None,
        };
        let robot_file = match wanted.hses_file {
            Some(port) => Some(bind(port).await?),
            None => None,
        };
        let host_control = match wanted.host_control {
            Some(port) => Some(listen(port).await?),
            None => None,
        };
        let camera = match wanted.camera {
            Some(port) => Some(listen(port).await?),
            None => None,
        };
        let serial = if wanted.has_serial {
            Some(SerialLine::open()?)
        } else {
            None
        };
        Ok(Self {
            robot,
            robot_file,
            host_control,
            serial,
            camera,
        })
    }

    /// Where the robot listens.
    pub fn robot_address(&self) -> Option<SocketAddr> {
        self.robot.as_ref().and_then(|socket| socket.local_addr().ok())
    }

    /// Where the robot listens for files.
    pub fn robot_file_address(&self) -> Option<SocketAddr> {
        self.robot_file.as_ref().and_then(|socket| socket.local_addr().ok())
    }

    /// Where host control listens.
    pub fn host_control_address(&self) -> Option<SocketAddr> {
        self.host_control.as_ref().and_then(|socket| socket.local_addr().ok())
    }

    /// Path of the serial line's end for the host.
    pub fn serial_path(&self) -> Option<&str> {
        self.serial.as_ref().map(|line| line.path.as_str())
    }

    /// Where the camera listens.
    pub fn camera_address(&self) -> Option<SocketAddr> {
        self.camera.as_ref().and_then(|socket| socket.local_addr().ok())
    }
}

async fn bind(port: u16) -> Result<UdpSocket, ShellError> {
    let opened = UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).await;
    opened.map_err(listen_error("UDP", port))
}

async fn listen(port: u16) -> Result<TcpListener, ShellError> {
    let opened = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).await;
    opened.map_err(listen_error("TCP", port))
}

fn listen_error(transport: &'static str, port: u16) -> impl FnOnce(io::Error) -> ShellError {
    move |source| ShellError::Listen {
        transport,
        port,
        source,
    }
}

/// Serves until `stop` ends. The truth is written after each acquisition, the last time before this returns.
pub async fn serve(
    cell: Cell,
    renderer: Arc<Renderer>,
    sockets: Sockets,
    truth_path: Option<PathBuf>,
    stop: impl Future<Output = ()>,
) -> Result<(), ShellError> {
    serve_with(cell, move |job| job.run(&renderer), sockets, truth_path, stop).await
}

/// As [`serve`]; frames come from `render`, which may look at them. It is called on threads of its own.
pub async fn serve_with(
    cell: Cell,
    render: impl Fn(&RenderJob) -> Frame + Send + Sync + 'static,
    sockets: Sockets,
    truth_path: Option<PathBuf>,
    stop: impl Future<Output = ()>,
) -> Result<(), ShellError> {
    serve_watched(cell, render, |_, _| (), sockets, truth_path, stop).await
}

/// As [`serve_with`]; `see` is called with everything that comes and with when it came, by the cell's clock; with what comes
/// over the serial line if that is watched ([`Cell::watch_serial`]).
pub async fn serve_watched(
    cell: Cell,
    render: impl Fn(&RenderJob) -> Frame + Send + Sync + 'static,
    mut see: impl FnMut(Instant, Seen<'_>),
    mut sockets: Sockets,
    truth_path: Option<PathBuf>,
    stop: impl Future<Output = ()>,
) -> Result<(), ShellError> {
    let (input_sender, mut inputs) = mpsc::channel(INPUT_COUNT_MAX);
    let (truth_sender, truths) = watch::channel(Arc::new(cell.truth().clone()));
    let truth_writer = truth_path.map(|path| tokio::spawn(write_truths(path, truths)));
    let mut shell = Shell {
        cell,
        render: Arc::new(render),
        start: Instant::now(),
        writers: BTreeMap::new(),
        serial: sockets.serial.take().map(|line| line.serve(input_sender.clone())),
        input_sender,
        truth_sender,
        connection_count: 0,
    };
    let served = shell.run(&sockets, &mut inputs, &mut see, stop).await;
    let written = shell.finish(truth_writer).await;
    served.and(written)
}

struct Shell {
    cell: Cell,
    render: Arc<dyn Fn(&RenderJob) -> Frame + Send + Sync>,
    start: Instant,
    /// Bytes on their way to each client of camera and host control. The cell never has more than one frame under way.
    writers: BTreeMap<u64, Connection>,
    serial: Option<ServedLine>,
    input_sender: mpsc::Sender<Input>,
    truth_sender: watch::Sender<Arc<Truth>>,
    connection_count: u64,
}

/// What listens on a TCP port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Service {
    Camera,
    HostControl,
}

impl Service {
    fn connected(self, connection: u64) -> Input {
        match self {
            Self::Camera => Input::CameraConnected { connection },
            Self::HostControl => Input::RobotPort(PortInput::Connected { connection }),
        }
    }

    fn bytes(self, connection: u64, bytes: Vec<u8>) -> Input {
        match self {
            Self::Camera => Input::CameraBytes { connection, bytes },
            Self::HostControl => Input::RobotPort(PortInput::Bytes { connection, bytes }),
        }
    }

    fn closed(self, connection: u64) -> Input {
        match self {
            Self::Camera => Input::CameraClosed { connection },
            Self::HostControl => Input::RobotPort(PortInput::Closed { connection }),
        }
    }
}

struct Connection {
    bytes: mpsc::UnboundedSender<Vec<u8>>,
    reader: JoinHandle<()>,
    writer: JoinHandle<()>,
}

impl Connection {
    /// Ends the connection from this side. What the client still sends is read for a while: closing over unread bytes
    /// would reset the connection and take the last bytes away from the client.
    async fn linger(self) {
        let Self {
            bytes,
            mut reader,
            writer,
        } = self;
        drop(bytes);
        tokio::time::timeout(WRITE_TIME_OUT, writer).await.ok();
        if tokio::time::timeout(LINGER, &mut reader).await.is_err() {
            reader.abort();
        }
    }
}

impl Shell {
    async fn run(
        &mut self,
        sockets: &Sockets,
        inputs: &mut mpsc::Receiver<Input>,
        see: &mut impl FnMut(Instant, Seen<'_>),
        stop: impl Future<Output = ()>,
    ) -> Result<(), ShellError> {
        let mut stop = std::pin::pin!(stop);
        let mut datagram = vec![0; DATAGRAM_BYTES_MAX];
        let mut file_datagram = vec![0; DATAGRAM_BYTES_MAX];
        loop {
            let wake_at = self
                .cell
                .wake_at()
                .map(|wake_ns| self.start + Duration::from_nanos(wake_ns));
            let input = tokio::select! {
                () = &mut stop => return Ok(()),
                received = receive(sockets.robot.as_ref(), &mut datagram) => {
                    let (byte_count, from) = received.map_err(socket_error("robot"))?;
                    Input::RobotDatagram { from, bytes: datagram[..byte_count].to_vec() }
                }
                received = receive(sockets.robot_file.as_ref(), &mut file_datagram) => {
                    let (byte_count, from) = received.map_err(socket_error("robot's file"))?;
                    let bytes = file_datagram[..byte_count].to_vec();
                    Input::RobotPort(PortInput::Datagram { port: Port::File, from, bytes })
                }
                accepted = accept(sockets.camera.as_ref()) => {
                    self.connect(Service::Camera, accepted.map_err(socket_error("camera"))?)
                }
                accepted = accept(sockets.host_control.as_ref()) => {
                    self.connect(Service::HostControl, accepted.map_err(socket_error("host control"))?)
                }
                Some(input) = inputs.recv() => input,
                () = sleep_until(wake_at) => Input::Wake,
            };
            see(Instant::now(), Seen::Input(&input));
            if let Input::CameraClosed { connection } | Input::RobotPort(PortInput::Closed { connection }) = &input {
                self.writers.remove(connection);
            }
            self.cell.handle_input(self.now_ns(), input);
            self.put_out(sockets).await;
            while let Some(passed) = self.cell.poll_passed() {
                see(self.start + Duration::from_nanos(passed.at_ns), Seen::Passed(passed));
            }
        }
    }

    async fn put_out(&mut self, sockets: &Sockets) {
        while let Some(output) = self.cell.poll_output() {
            match output {
                Output::RobotDatagram { to, bytes } => send_to(sockets.robot.as_ref(), to, &bytes).await,
                Output::CameraBytes { connection, bytes } => self.write(connection, bytes),
                Output::CameraClose { connection } => self.close(connection),
                Output::RobotPort(PortOutput::Datagram { to, bytes, .. }) => {
                    send_to(sockets.robot_file.as_ref(), to, &bytes).await;
                }
                Output::RobotPort(output) => self.put_out_robot(output),
                Output::Render(job) => self.render(job),
                // Nobody listens when no file of it is wanted.
                Output::TruthGrew if self.truth_sender.is_closed() => {}
                Output::TruthGrew => {
                    self.truth_sender.send_replace(Arc::new(self.cell.truth().clone()));
                }
                Output::Violation(text) => log(&format!("SIMULATED cell: protocol violation: {text}")),
            }
        }
    }

    fn put_out_robot(&mut self, output: PortOutput) {
        match output {
            PortOutput::Bytes { connection, bytes } => self.write(connection, bytes),
            PortOutput::Close { connection } => self.close(connection),
            PortOutput::Serial(bytes) => {
                if let Some(serial) = &self.serial {
                    // A line whose writer has ended is told when it ends.
                    serial.bytes.send(bytes).ok();
                }
            }
            // These have been put out by now.
            PortOutput::Datagram { .. } | PortOutput::Violation(_) => (),
        }
    }

    fn write(&self, connection: u64, bytes: Vec<u8>) {
        if let Some(connection) = self.writers.get(&connection) {
            // A writer that has ended leaves a closed connection, which its reader reports.
            connection.bytes.send(bytes).ok();
        }
    }

    fn close(&mut self, connection: u64) {
        if let Some(connection) = self.writers.remove(&connection) {
            tokio::spawn(connection.linger());
        }
    }

    fn connect(&mut self, service: Service, stream: TcpStream) -> Input {
        self.connection_count += 1;
        let connection = self.connection_count;
        if let Err(error) = stream.set_nodelay(true) {
            log(&format!("connection {connection}: no TCP_NODELAY: {error}"));
        }
        let address = stream.peer_addr().ok();
        let (reader, writer) = stream.into_split();
        let (bytes, to_write) = mpsc::unbounded_channel();
        let state = Connection {
            bytes,
            reader: tokio::spawn(read(service, connection, reader, self.input_sender.clone())),
            writer: tokio::spawn(write(writer, to_write)),
        };
        self.writers.insert(connection, state);
        match (service, address) {
            (Service::Camera, Some(address)) => {
                self.cell.handle_input(self.now_ns(), service.connected(connection));
                Input::CameraAddress { connection, address }
            }
            _ => service.connected(connection),
        }
    }

    fn render(&self, job: RenderJob) {
        let (render, inputs) = (Arc::clone(&self.render), self.input_sender.clone());
        tokio::task::spawn_blocking(move || {
            let frame = render(&job);
            // The shell may have ended meanwhile; nobody waits for the frame then.
            inputs.blocking_send(Input::Rendered { job: job.job, frame }).ok();
        });
    }

    /// Says good-bye to the clients, then waits for the last truth and the last bytes.
    async fn finish(mut self, truth_writer: Option<JoinHandle<Result<(), ShellError>>>) -> Result<(), ShellError> {
        self.cell.shut_down(self.now_ns());
        while let Some(output) = self.cell.poll_output() {
            if let Output::CameraBytes { connection, bytes } = output
                && let Some(connection) = self.writers.get(&connection)
            {
                connection.bytes.send(bytes).ok();
            }
        }
        let Self {
            writers, truth_sender, ..
        } = self;
        drop(truth_sender);
        let written = match truth_writer {
            Some(writer) => writer.await.unwrap_or(Ok(())),
            None => Ok(()),
        };
        for connection in writers.into_values() {
            connection.linger().await;
        }
        written
    }

    fn now_ns(&self) -> u64 {
        self.start.elapsed().as_nanos() as u64
    }
}

async fn receive(socket: Option<&UdpSocket>, datagram: &mut [u8]) -> io::Result<(usize, SocketAddr)> {
    match socket {
        Some(socket) => socket.recv_from(datagram).await,
        None => std::future::pending().await,
    }
}

async fn send_to(socket: Option<&UdpSocket>, to: SocketAddr, bytes: &[u8]) {
    if let Some(socket) = socket
        && let Err(error) = socket.send_to(bytes, to).await
    {
        log(&format!("an answer to {to} is lost: {error}"));
    }
}

async fn accept(listener: Option<&TcpListener>) -> io::Result<TcpStream> {
    match listener {
        Some(listener) => listener.accept().await.map(|(stream, _)| stream),
        None => std::future::pending().await,
    }
}

async fn sleep_until(wake_at: Option<Instant>) {
    match wake_at {
        Some(wake_at) => tokio::time::sleep_until(wake_at.into()).await,
        None => std::future::pending().await,
    }
}

/// Reads a connection until it ends. The bounded channel holds the client back when the cell is busy.
async fn read(service: Service, connection: u64, mut stream: OwnedReadHalf, inputs: mpsc::Sender<Input>) {
    let mut piece = vec![0; READ_BYTES];
    loop {
        let byte_count = stream.read(&mut piece).await.unwrap_or(0);
        let input = match byte_count {
            0 => service.closed(connection),
            _ => service.bytes(connection, piece[..byte_count].to_vec()),
        };
        if inputs.send(input).await.is_err() || byte_count == 0 {
            return;
        }
    }
}

/// Writes a connection until its channel ends or the client takes nothing any more.
async fn write(mut stream: OwnedWriteHalf, mut bytes: mpsc::UnboundedReceiver<Vec<u8>>) {
    while let Some(bytes) = bytes.recv().await {
        match tokio::time::timeout(WRITE_TIME_OUT, stream.write_all(&bytes)).await {
            Ok(Ok(())) => (),
            _ => return,
        }
    }
    stream.shutdown().await.ok();
}

/// Writes the newest truth whenever it has changed, and the last one before it ends.
async fn write_truths(path: PathBuf, mut truths: watch::Receiver<Arc<Truth>>) -> Result<(), ShellError> {
    while truths.changed().await.is_ok() {
        let truth = Arc::clone(&truths.borrow_and_update());
        let target = path.clone();
        let written = tokio::task::spawn_blocking(move || truth.write(&target))
            .await
            .unwrap_or(Ok(()));
        if let Err(source) = written {
            log(&format!("cannot write {}: {source}", path.display()));
            return Err(ShellError::Truth { path, source });
        }
    }
    Ok(())
}

fn socket_error(device: &'static str) -> impl Fn(io::Error) -> ShellError {
    move |source| ShellError::Socket { device, source }
}

/// One line for people; a closed standard error loses it.
fn log(line: &str) {
    writeln!(io::stderr(), "{line}").ok();
}

const DATAGRAM_BYTES_MAX: usize = 2048;
const INPUT_COUNT_MAX: usize = 64;
const READ_BYTES: usize = 65_536;
const LINGER: Duration = Duration::from_millis(500);
const WRITE_TIME_OUT: Duration = Duration::from_secs(5);

#[cfg(test)]
#[path = "shell_tests.rs"]
mod tests;
