//! Between the program and the simulated robot: passes every datagram on and remembers the acts.

use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// What passed.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Passed {
    /// A request that can move something: move, servo on, hold off, job start.
    Act(Vec<u8>),
    /// The robot has accepted this move.
    Accepted(Vec<u8>),
    /// The arm was held or servo power switched off.
    Stopped,
    /// Another process speaks from here on.
    NewProcess,
}

/// A running proxy; it ends when it is dropped.
pub(super) struct Proxy {
    pub(super) address: SocketAddr,
    passed: Arc<Mutex<Vec<Passed>>>,
    ends: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Default)]
struct Open {
    client: Option<SocketAddr>,
    /// The last request of each id.
    requests: Vec<Option<Vec<u8>>>,
}

impl Proxy {
    pub(super) fn start(robot: SocketAddr) -> std::io::Result<Self> {
        let front = UdpSocket::bind("127.0.0.1:0")?;
        let back = UdpSocket::bind("127.0.0.1:0")?;
        back.connect(robot)?;
        front.set_read_timeout(Some(TURN))?;
        back.set_read_timeout(Some(TURN))?;
        let (passed, ends) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let open = Arc::new(Mutex::new(Open {
            client: None,
            requests: vec![None; 256],
        }));
        let address = front.local_addr()?;
        let forth = {
            let (front, back) = (front.try_clone()?, back.try_clone()?);
            let (passed, open, ends) = (passed.clone(), open.clone(), ends.clone());
            std::thread::spawn(move || pass_requests(&front, &back, &passed, &open, &ends))
        };
        let back_again = {
            let (passed, ends) = (passed.clone(), ends.clone());
            std::thread::spawn(move || pass_answers(&front, &back, &passed, &open, &ends))
        };
        Ok(Self {
            address,
            passed,
            ends,
            threads: vec![forth, back_again],
        })
    }

    /// Everything that has passed, in order.
    pub(super) fn passed(&self) -> Vec<Passed> {
        self.passed.lock().map(|passed| passed.clone()).unwrap_or_default()
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            thread.join().ok();
        }
    }
}

fn pass_requests(
    front: &UdpSocket,
    back: &UdpSocket,
    passed: &Mutex<Vec<Passed>>,
    open: &Mutex<Open>,
    ends: &AtomicBool,
) {
    let mut datagram = [0; DATAGRAM_BYTES];
    while !ends.load(Ordering::Relaxed) {
        let Ok((length, from)) = front.recv_from(&mut datagram) else {
            continue;
        };
        let bytes = &datagram[..length];
        if let (Ok(mut open), Ok(mut passed)) = (open.lock(), passed.lock()) {
            if open.client.is_some_and(|client| client != from) {
                passed.push(Passed::NewProcess);
            }
            open.client = Some(from);
            if length > COMMAND {
                open.requests[usize::from(bytes[REQUEST_ID])] = Some(bytes.to_vec());
                if is_act(bytes) {
                    passed.push(Passed::Act(bytes.to_vec()));
                } else if command(bytes) == SWITCH {
                    passed.push(Passed::Stopped);
                }
            }
        }
        back.send(bytes).ok();
    }
}

fn pass_answers(
    front: &UdpSocket,
    back: &UdpSocket,
    passed: &Mutex<Vec<Passed>>,
    open: &Mutex<Open>,
    ends: &AtomicBool,
) {
    let mut datagram = [0; DATAGRAM_BYTES];
    while !ends.load(Ordering::Relaxed) {
        let Ok(length) = back.recv(&mut datagram) else { continue };
        let bytes = &datagram[..length];
        let Ok(mut open) = open.lock() else { return };
        if length > COMMAND + 1 && bytes[STATUS] == 0 {
            let request = open.requests[usize::from(bytes[REQUEST_ID])].take();
            if let (Some(request), Ok(mut passed)) = (request.filter(|request| command(request) == MOVE), passed.lock())
            {
                passed.push(Passed::Accepted(request));
            }
        }
        if let Some(client) = open.client {
            front.send_to(bytes, client).ok();
        }
    }
}

/// A move, a job's start, or a switch (servo, hold) to the side that lets the arm go.
fn is_act(bytes: &[u8]) -> bool {
    let switched = bytes.get(PAYLOAD).copied();
    let lets_go = match bytes.get(INSTANCE) {
        // Hold off is 2, servo on is 1.
        Some(1) => switched == Some(2),
        Some(2) => switched == Some(1),
        _ => false,
    };
    match command(bytes) {
        MOVE | START => true,
        SWITCH => lets_go,
        _ => false,
    }
}

fn command(bytes: &[u8]) -> u16 {
    u16::from_le_bytes([bytes[COMMAND - 1], bytes[COMMAND]])
}

/// Offsets and numbers of `docs/protocols/hses.md`.
const REQUEST_ID: usize = 11;
const COMMAND: usize = 25;
const STATUS: usize = 25;
const INSTANCE: usize = 26;
const PAYLOAD: usize = 32;
const SWITCH: u16 = 0x83;
const START: u16 = 0x86;
const MOVE: u16 = 0x8A;
const DATAGRAM_BYTES: usize = 2048;
const TURN: Duration = Duration::from_millis(20);
