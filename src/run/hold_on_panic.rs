//! The last word to the robot if the loop itself panics.

use crate::robot::{Command, hses};
use std::net::UdpSocket;

/// Sends hold when it is dropped by a panic: a bug of ours must not leave the arm moving on.
#[derive(Debug)]
pub(super) struct HoldOnPanic {
    robot: UdpSocket,
}

impl HoldOnPanic {
    /// Guards the robot behind a connected, non-blocking socket.
    pub(super) fn new(robot: UdpSocket) -> Self {
        Self { robot }
    }
}

impl Drop for HoldOnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            for id in HOLD_IDS {
                // Nobody is left to hear of an error.
                if let Ok(hold) = hses::request(&Command::HoldOn, id) {
                    self.robot.send(&hold.encode()).ok();
                }
            }
        }
    }
}

/// Several datagrams, since one may be lost and nobody will ask again.
const HOLD_IDS: [u8; 3] = [253, 254, 255];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vectors::hses;
    use std::time::Duration;

    fn sent_by(ending: impl FnOnce(HoldOnPanic) + Send + 'static) -> Vec<Vec<u8>> {
        let robot = UdpSocket::bind("127.0.0.1:0").unwrap();
        robot.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
        let client = UdpSocket::bind("127.0.0.1:0").unwrap();
        client.connect(robot.local_addr().unwrap()).unwrap();
        std::thread::spawn(move || ending(HoldOnPanic::new(client))).join().ok();
        let mut buffer = [0; 64];
        std::iter::from_fn(|| robot.recv(&mut buffer).ok().map(|length| buffer[..length].to_vec())).collect()
    }

    #[test]
    fn a_panic_holds_the_arm_and_a_normal_end_says_nothing() {
        let sent = sent_by(|_guard| panic!("a bug"));
        assert_eq!(sent.len(), HOLD_IDS.len());
        for (mut datagram, id) in sent.into_iter().zip(HOLD_IDS) {
            assert_eq!(datagram[11], id);
            datagram[11] = 1;
            assert_eq!(datagram, hses("req_hold_on"));
        }
        assert!(sent_by(drop).is_empty());
    }
}
