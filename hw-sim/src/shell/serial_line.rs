//! The serial line as a pseudo-terminal: the cell has one end, the host opens the other by its path.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;

use tokio::io::{AsyncReadExt, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::sync::mpsc;
use tokio_serial::{SerialPort, SerialStream};

use super::log;
use crate::cell::Input;
use crate::robot::ports::PortInput;

/// A line nobody serves yet.
#[derive(Debug)]
pub(super) struct SerialLine {
    /// Path that the host opens.
    pub(super) path: String,
    controller: SerialStream,
    host: File,
}

/// A line that is served until this is dropped.
pub(super) struct ServedLine {
    /// Bytes for the host.
    pub(super) bytes: mpsc::UnboundedSender<Vec<u8>>,
    /// The host's end stays open here: without it the line would end whenever a host closes it.
    _host: File,
}

impl SerialLine {
    pub(super) fn open() -> Result<Self, tokio_serial::Error> {
        let (controller, host) = SerialStream::pair()?;
        let path = host.name().unwrap_or_default();
        // As a plain file: the other type takes a lock, and a host that wants the line for itself could not have it.
        let host = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(O_NOCTTY)
            .open(&path)?;
        Ok(Self { path, controller, host })
    }

    pub(super) fn serve(self, inputs: mpsc::Sender<Input>) -> ServedLine {
        let (reader, writer) = tokio::io::split(self.controller);
        let (bytes, to_write) = mpsc::unbounded_channel();
        tokio::spawn(read(reader, inputs));
        tokio::spawn(write(writer, to_write));
        ServedLine {
            bytes,
            _host: self.host,
        }
    }
}

/// Reads the line until the cell ends. The bounded channel holds the host back when the cell is busy.
async fn read(mut line: ReadHalf<SerialStream>, inputs: mpsc::Sender<Input>) {
    let mut piece = [0; READ_BYTES];
    loop {
        match line.read(&mut piece).await {
            Ok(byte_count) if byte_count > 0 => {
                let bytes = piece[..byte_count].to_vec();
                if inputs.send(Input::RobotPort(PortInput::Serial(bytes))).await.is_err() {
                    return;
                }
            }
            ended => return log(&format!("the serial line has ended: {ended:?}")),
        }
    }
}

/// Writes the line until its channel ends.
async fn write(mut line: WriteHalf<SerialStream>, mut bytes: mpsc::UnboundedReceiver<Vec<u8>>) {
    while let Some(bytes) = bytes.recv().await {
        if let Err(error) = line.write_all(&bytes).await {
            return log(&format!("the serial line takes no more bytes: {error}"));
        }
    }
}

/// Linux: the line never becomes the terminal that controls this process.
const O_NOCTTY: i32 = 0o400;
const READ_BYTES: usize = 1024;
