//! Sockets for datagrams.

use std::io;
use std::net::{SocketAddr, UdpSocket};

/// A socket that speaks with this address alone and does not block.
pub(super) fn connected(address: SocketAddr) -> io::Result<UdpSocket> {
    let local: SocketAddr = if address.is_ipv4() {
        ([0, 0, 0, 0], 0).into()
    } else {
        ([0u16; 8], 0).into()
    };
    let socket = UdpSocket::bind(local)?;
    socket.connect(address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

/// Datagrams of HSES are at most 511 bytes; room for more shows foreign ones whole.
pub(super) const DATAGRAM_BYTES: usize = 2048;
