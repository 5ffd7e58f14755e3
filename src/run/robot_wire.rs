//! The wire to the robot: datagrams, a TCP connection, or a serial line.

use super::datagrams;
use super::hold_on_panic::HoldOnPanic;
use super::live::{LiveError, RobotPlace};
use super::wires::{self, Place};
use crate::controller::Input;
use std::net::SocketAddr;
use tokio::net::UdpSocket;
use tokio::sync::mpsc;

/// The wire to the robot.
pub(super) enum RobotWire {
    /// HSES.
    Datagrams { socket: UdpSocket, address: SocketAddr },
    /// Host control: the stream, when it is open.
    Stream {
        place: Place,
        outgoing: Option<mpsc::Sender<Vec<u8>>>,
    },
}

impl RobotWire {
    /// The wire; a serial line is open from here on, a connection when it is asked for. The guard holds the arm if the
    /// loop panics; it exists where one datagram is enough for that.
    pub(super) fn open(
        place: &RobotPlace,
        news: &mpsc::Sender<Input>,
    ) -> Result<(Self, Option<HoldOnPanic>), LiveError> {
        let stream = |place, outgoing| Self::Stream { place, outgoing };
        Ok(match place {
            RobotPlace::Hses(address) => {
                let socket = datagrams::connected(*address).map_err(LiveError::Socket)?;
                let guard = HoldOnPanic::new(socket.try_clone().map_err(LiveError::Socket)?);
                let socket = UdpSocket::from_std(socket).map_err(LiveError::Socket)?;
                let address = *address;
                (Self::Datagrams { socket, address }, Some(guard))
            }
            RobotPlace::HostControl(address) => (stream(Place::Tcp(*address), None), None),
            RobotPlace::Serial { device, baud } => {
                let place = Place::Serial {
                    device: device.clone(),
                    baud: *baud,
                };
                let outgoing = wires::open(place.clone(), wires::ROBOT, news.clone());
                (stream(place, Some(outgoing)), None)
            }
        })
    }

    /// The next datagram. A stream reports by itself: then this waits for ever.
    pub(super) async fn recv(&self, datagram: &mut [u8]) -> Input {
        match self {
            Self::Datagrams { socket, address } => match socket.recv(datagram).await {
                Ok(length) => Input::RobotBytes(datagram[..length].to_vec()),
                Err(error) => Input::RobotUnreachable {
                    reason: format!("{address}: {error}"),
                },
            },
            Self::Stream { .. } => std::future::pending().await,
        }
    }

    /// Sends. What goes wrong is heard from the receiving side; a full buffer is as good as a lost datagram.
    pub(super) async fn send(&self, bytes: Vec<u8>) {
        match self {
            Self::Datagrams { socket, .. } => {
                socket.send(&bytes).await.ok();
            }
            Self::Stream { outgoing, .. } => {
                if let Some(outgoing) = outgoing {
                    outgoing.send(bytes).await.ok();
                }
            }
        }
    }

    pub(super) fn connect(&mut self, news: &mpsc::Sender<Input>) {
        if let Self::Stream { place, outgoing } = self {
            *outgoing = Some(wires::open(place.clone(), wires::ROBOT, news.clone()));
        }
    }

    pub(super) fn close(&mut self) {
        if let Self::Stream { outgoing, .. } = self {
            *outgoing = None;
        }
    }
}
