//! Sockets for [`crate::camera::lines`]: one thread a connection reads, everything else waits in turn.

use crate::camera::lines::{Carry, Deed, LineId, News};
use crate::stamp::Stamp;
use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

/// What carries the deeds of [`crate::camera::lines::Lines`] out over TCP connections to this address.
pub fn camera_lines(address: SocketAddr) -> Carry<'static> {
    let mut sockets = Sockets::new(address);
    Box::new(move |deed| sockets.carry_out(deed))
}

struct Sockets {
    address: SocketAddr,
    began: Instant,
    streams: BTreeMap<LineId, TcpStream>,
    news: Receiver<News>,
    news_sender: Sender<News>,
}

impl Sockets {
    fn new(address: SocketAddr) -> Self {
        let (news_sender, news) = channel();
        Self {
            address,
            began: Instant::now(),
            streams: BTreeMap::new(),
            news,
            news_sender,
        }
    }

    fn carry_out(&mut self, deed: Deed) -> (Stamp, Option<News>) {
        let news = match deed {
            Deed::Connect { line } => {
                self.connect(line);
                None
            }
            Deed::Bytes { line, bytes } => {
                // What goes wrong is heard from the reading side.
                if let Some(stream) = self.streams.get_mut(&line) {
                    stream.write_all(&bytes).ok();
                }
                None
            }
            Deed::Close { line } => {
                if let Some(stream) = self.streams.remove(&line) {
                    stream.shutdown(Shutdown::Both).ok();
                }
                None
            }
            Deed::Wait { until } => self.wait(until),
        };
        (self.now(), news)
    }

    fn connect(&mut self, line: LineId) {
        let news = match TcpStream::connect_timeout(&self.address, CONNECT_TIME_OUT).and_then(ready) {
            Ok((stream, reader)) => {
                self.streams.insert(line, stream);
                let sender = self.news_sender.clone();
                std::thread::spawn(move || read(line, reader, &sender));
                News::Connected { line }
            }
            Err(error) => News::Closed {
                line,
                reason: format!("{}: {error}", self.address),
            },
        };
        self.news_sender.send(news).ok();
    }

    /// The first news of a connection that is still wanted.
    fn wait(&mut self, until: Stamp) -> Option<News> {
        loop {
            let left = Duration::from_nanos(until.ns.saturating_sub(self.now().ns));
            let news = self.news.recv_timeout(left).ok()?;
            match &news {
                News::Bytes { line, .. } if !self.streams.contains_key(line) => {}
                News::Closed { line, .. } => {
                    self.streams.remove(line);
                    return Some(news);
                }
                _ => return Some(news),
            }
        }
    }

    fn now(&self) -> Stamp {
        Stamp {
            ns: self.began.elapsed().as_nanos() as u64,
        }
    }
}

fn ready(stream: TcpStream) -> std::io::Result<(TcpStream, TcpStream)> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_TIME_OUT))?;
    let reader = stream.try_clone()?;
    Ok((stream, reader))
}

fn read(line: LineId, mut stream: TcpStream, news: &Sender<News>) {
    let mut buffer = vec![0; READ_BYTES];
    let reason = loop {
        match stream.read(&mut buffer) {
            Ok(0) => break "the server closed the connection".to_owned(),
            Ok(length) => {
                let bytes = buffer[..length].to_vec();
                if news.send(News::Bytes { line, bytes }).is_err() {
                    return;
                }
            }
            Err(error) => break error.to_string(),
        }
    };
    news.send(News::Closed { line, reason }).ok();
}

const CONNECT_TIME_OUT: Duration = Duration::from_secs(3);
const WRITE_TIME_OUT: Duration = Duration::from_secs(5);
const READ_BYTES: usize = 128 << 10;
