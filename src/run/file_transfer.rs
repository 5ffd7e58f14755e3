//! One file to or from the controller, outside of a run.

use super::clock::Clock;
use super::datagrams::{self, DATAGRAM_BYTES};
use super::live::RobotPlace;
use super::wires::{self, Place};
use crate::controller::Input;
use crate::robot::host::{HostLink, LinkEvent, SerialLink, SerialSettings};
use crate::robot::hses::{FileEvent, FileSettings, Files};
use crate::robot::{FileCommand, Refusal, RobotOutput};
use crate::stamp::Stamp;
use std::net::SocketAddr;
use thiserror::Error;
use tokio::net::UdpSocket;
use tokio::sync::mpsc;

/// Why a file has not gone its way. Of a file that was to go to the controller nothing is known then: look at the list.
#[derive(Debug, Error)]
pub enum TransferError {
    /// A socket of ours, or the serial line.
    #[error("{0}")]
    Wire(String),
    /// The robot said no.
    #[error("{what}: {words}")]
    Refused {
        /// What was asked.
        what: &'static str,
        /// Why not, and what to do.
        words: String,
    },
    /// Nobody answered.
    #[error("{0}: no answer")]
    Unanswered(&'static str),
    /// The controller's file is larger than any that is taken.
    #[error("{0}: the file is too large to be a job")]
    TooLarge(&'static str),
    /// What is spoken has no words for it.
    #[error("{0}")]
    Unsayable(String),
}

/// What came of a file command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Transferred {
    /// The names, as the controller writes them.
    Names(Vec<String>),
    /// The file's bytes.
    Content(Vec<u8>),
    /// Carried out.
    Done,
}

/// Asks for one thing about files. `file_port` is HSES' port for files.
///
/// # Errors
///
/// The controller refuses, nobody answers, or what is spoken has no words for it.
pub async fn transfer(
    place: &RobotPlace,
    file_port: Option<SocketAddr>,
    settings: FileSettings,
    command: FileCommand,
) -> Result<Transferred, TransferError> {
    match place {
        RobotPlace::Hses(address) => {
            let mut port = *address;
            // The file port stands beside the robot's: 10041 and 10040.
            port.set_port(address.port().wrapping_add(1));
            over_hses(file_port.unwrap_or(port), settings, command).await
        }
        RobotPlace::Serial { device, baud } => {
            let place = Place::Serial {
                device: device.clone(),
                baud: *baud,
            };
            over_serial(place, command).await
        }
        RobotPlace::HostControl(_) => Err(TransferError::Unsayable(format!(
            "host control over TCP has no words for {}: use HSES or the serial line",
            command.name()
        ))),
    }
}

async fn over_hses(
    address: SocketAddr,
    settings: FileSettings,
    command: FileCommand,
) -> Result<Transferred, TransferError> {
    let wire = |error: std::io::Error| TransferError::Wire(format!("{address}: {error}"));
    let socket = datagrams::connected(address)
        .and_then(UdpSocket::from_std)
        .map_err(wire)?;
    let clock = Clock::start();
    let mut files = Files::new(settings);
    files.begin(Stamp::START, command).expect("nothing is open yet");
    let mut datagram = vec![0u8; DATAGRAM_BYTES];
    loop {
        while let Some(output) = files.poll_output() {
            if let RobotOutput::Bytes { bytes, .. } = output {
                // What is wrong is heard from the receiving side.
                socket.send(&bytes).await.ok();
            }
        }
        while let Some(event) = files.poll_event() {
            if let Some(result) = result_of(event) {
                return result;
            }
        }
        tokio::select! {
            received = socket.recv(&mut datagram) => {
                let length = received.map_err(wire)?;
                files.handle_datagram(clock.now(), &datagram[..length]);
            }
            () = clock.sleep_until(files.wake_at()) => files.handle_wake(clock.now()),
        }
    }
}

fn result_of(event: FileEvent) -> Option<Result<Transferred, TransferError>> {
    Some(match event {
        FileEvent::Listed { names, .. } => Ok(Transferred::Names(names)),
        FileEvent::Saved { content, .. } => Ok(Transferred::Content(content)),
        FileEvent::Loaded { .. } | FileEvent::Deleted { .. } => Ok(Transferred::Done),
        FileEvent::Refused { command, refusal } => Err(refused(command.name(), refusal)),
        FileEvent::Unanswered { command } => Err(TransferError::Unanswered(command.name())),
        FileEvent::TooLarge { command } => Err(TransferError::TooLarge(command.name())),
        FileEvent::Dropped { .. } => return None,
    })
}

async fn over_serial(place: Place, command: FileCommand) -> Result<Transferred, TransferError> {
    let what = command.name();
    let (news_sender, mut news) = mpsc::channel(NEWS_MAX);
    let outgoing = wires::open(place, wires::ROBOT, news_sender);
    let clock = Clock::start();
    let mut link = SerialLink::new(SerialSettings::default());
    link.transfer(Stamp::START, &command)
        .map_err(|error| TransferError::Unsayable(format!("the serial line: {error}")))?;
    loop {
        while let Some(output) = link.poll_output() {
            if let RobotOutput::Bytes { bytes, .. } = output {
                outgoing.send(bytes).await.ok();
            }
        }
        while let Some(event) = link.poll_event() {
            match event {
                LinkEvent::Answered(_) => return Ok(Transferred::Done),
                LinkEvent::Saved { content, .. } => return Ok(Transferred::Content(content)),
                LinkEvent::Listed { names } => return Ok(Transferred::Names(names)),
                LinkEvent::Refused(refusal) => return Err(refused(what, refusal)),
                LinkEvent::Unanswered => return Err(TransferError::Unanswered(what)),
                LinkEvent::Progress { .. } | LinkEvent::Dropped { .. } | LinkEvent::Lost { .. } => {}
            }
        }
        tokio::select! {
            input = news.recv() => match input {
                Some(Input::RobotBytes(bytes)) => link.handle_bytes(clock.now(), &bytes),
                Some(Input::RobotClosed { reason }) => return Err(TransferError::Wire(reason)),
                Some(_) => {}
                None => return Err(TransferError::Wire("the serial line has ended".into())),
            },
            () = clock.sleep_until(link.wake_at()) => link.handle_wake(clock.now()),
        }
    }
}

fn refused(what: &'static str, refusal: Refusal) -> TransferError {
    TransferError::Refused {
        what,
        words: refusal.words(),
    }
}

const NEWS_MAX: usize = 32;
