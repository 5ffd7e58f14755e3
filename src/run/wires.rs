//! Streams of bytes to the devices: TCP connections and serial lines, each served by a task of its own.

use crate::controller::Input;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep};
use tokio_serial::{DataBits, FlowControl, Parity, SerialPortBuilderExt as _, SerialStream, StopBits};

/// How the inputs of one device's stream are named.
#[derive(Debug, Clone, Copy)]
pub(super) struct Names {
    /// Who is at the other end, for people.
    device: &'static str,
    /// The connection stands.
    connected: fn() -> Input,
    /// Bytes have come.
    bytes: fn(Vec<u8>) -> Input,
    /// The connection did not come about or has ended.
    closed: fn(String) -> Input,
}

/// The inputs of the camera's stream.
pub(super) const CAMERA: Names = Names {
    device: "camera",
    connected: || Input::CameraConnected,
    bytes: Input::CameraBytes,
    closed: |reason| Input::CameraClosed { reason },
};

/// The inputs of the robot's stream.
pub(super) const ROBOT: Names = Names {
    device: "robot",
    connected: || Input::RobotConnected,
    bytes: Input::RobotBytes,
    closed: |reason| Input::RobotClosed { reason },
};

/// Where a stream leads to.
#[derive(Debug, Clone)]
pub(super) enum Place {
    /// A TCP port.
    Tcp(SocketAddr),
    /// A serial line: 8 data bits, even parity, 1 stop bit (`docs/protocols/bsc_like.md`).
    Serial {
        /// Its path.
        device: PathBuf,
        /// Bits per second.
        baud: u32,
    },
}

/// Opens a stream; what is sent on the returned queue is written to it. Dropping the queue closes the stream.
pub(super) fn open(place: Place, names: Names, news: mpsc::Sender<Input>) -> mpsc::Sender<Vec<u8>> {
    let (sender, outgoing) = mpsc::channel(QUEUE_MAX);
    tokio::spawn(async move {
        match place {
            Place::Tcp(address) => serve_tcp(address, outgoing, names, news).await,
            Place::Serial { device, baud } => match open_serial(&device, baud) {
                Ok(stream) => serve(stream, outgoing, names, &news).await,
                Err(error) => {
                    let reason = format!("{}: {error}", device.display());
                    news.send((names.closed)(reason)).await.ok();
                }
            },
        }
    });
    sender
}

async fn serve_tcp(
    address: SocketAddr,
    mut outgoing: mpsc::Receiver<Vec<u8>>,
    names: Names,
    news: mpsc::Sender<Input>,
) {
    // A close before the connection stands drops the sender, which ends the wait.
    let stream = tokio::select! {
        stream = TcpStream::connect(address) => stream,
        () = until_closed(&mut outgoing) => return,
    };
    match stream {
        Ok(stream) => {
            stream.set_nodelay(true).ok();
            serve(stream, outgoing, names, &news).await;
        }
        Err(error) => {
            news.send((names.closed)(format!("{address}: {error}"))).await.ok();
        }
    }
}

fn open_serial(device: &Path, baud: u32) -> io::Result<SerialStream> {
    let stream = tokio_serial::new(device.to_string_lossy(), baud)
        .data_bits(DataBits::Eight)
        .parity(Parity::Even)
        .stop_bits(StopBits::One)
        .flow_control(FlowControl::None)
        .open_native_async()?;
    Ok(stream)
}

/// Writes what it is given, reports what comes, until either side ends.
async fn serve(
    stream: impl AsyncRead + AsyncWrite + Send + 'static,
    mut outgoing: mpsc::Receiver<Vec<u8>>,
    names: Names,
    news: &mpsc::Sender<Input>,
) {
    let (mut reader, mut writer) = tokio::io::split(stream);
    if news.send((names.connected)()).await.is_err() {
        return;
    }
    let mut writing = tokio::spawn(async move {
        while let Some(bytes) = outgoing.recv().await {
            if writer.write_all(&bytes).await.is_err() {
                // The reader reports the end.
                return until_closed(&mut outgoing).await;
            }
        }
        writer.shutdown().await.ok();
    });
    let mut buffer = vec![0u8; READ_BYTES];
    // Closed from this side: what still comes is read for a while, so that our last bytes arrive, but nobody waits for it.
    let lingering = sleep(LINGER);
    tokio::pin!(lingering);
    let mut is_closing = false;
    let reason = loop {
        let read = tokio::select! {
            read = reader.read(&mut buffer) => read,
            _ = &mut writing, if !is_closing => {
                is_closing = true;
                lingering.as_mut().reset(Instant::now() + LINGER);
                continue;
            }
            // The other end of a half-open connection never closes.
            () = &mut lingering, if is_closing => break None,
        };
        let told = !writing.is_finished();
        match read {
            Ok(0) => break told.then(|| format!("the {} closed the connection", names.device)),
            Err(error) => break told.then(|| error.to_string()),
            Ok(length) if told => {
                // Where nobody listens any more, a newer connection has taken this one's place.
                news.send((names.bytes)(buffer[..length].to_vec())).await.ok();
            }
            Ok(_) => {}
        }
    };
    if let Some(reason) = reason {
        news.send((names.closed)(reason)).await.ok();
    }
    writing.abort();
}

async fn until_closed(outgoing: &mut mpsc::Receiver<Vec<u8>>) {
    while outgoing.recv().await.is_some() {}
}

const READ_BYTES: usize = 128 << 10;
const QUEUE_MAX: usize = 32;
/// How long a connection that we closed is still read.
const LINGER: Duration = Duration::from_secs(1);

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::timeout;

    #[test]
    fn a_connection_that_we_closed_ends_though_its_peer_never_closes() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .unwrap();
        runtime.block_on(async {
            let (ours, peer) = tokio::io::duplex(64);
            let (sender, outgoing) = mpsc::channel(1);
            let (news_sender, mut news) = mpsc::channel(4);
            let serving = tokio::spawn(async move { serve(ours, outgoing, CAMERA, &news_sender).await });
            assert!(matches!(news.recv().await, Some(Input::CameraConnected)));
            drop(sender);
            timeout(Duration::from_secs(60), serving).await.unwrap().unwrap();
            assert!(news.recv().await.is_none(), "what we closed is not told");
            drop(peer);
        });
    }
}
