//! The bridge's shell: listens, runs the vendor's side, reads the frames' files. It moves bytes and decides nothing.

mod client;
mod files;
mod vendor;

use crate::camera::bridge::{Bridge, BridgeConfig, BridgeOutput, ConnectionId, FrameError, Picture};
use crate::stamp::Stamp;
use client::Client;
use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use thiserror::Error;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::time::Instant;
use vendor::Vendor;

/// What the bridge has to say to the person who started it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BridgeReport {
    /// The vendor's side may connect.
    VendorListening(SocketAddr),
    /// The device is there; controllers and observers may connect.
    Listening(SocketAddr),
    /// A line for the log.
    Note(String),
}

/// Why the bridge cannot serve.
#[derive(Debug, Error)]
pub enum BridgeError {
    /// A port cannot be listened on.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// Which.
        address: SocketAddr,
        /// Why not.
        source: io::Error,
    },
}

/// Serves until `stop` is there. Nobody is let in before the vendor's side has said which device it has.
///
/// # Errors
///
/// A port cannot be listened on.
pub async fn serve_bridge(
    config: BridgeConfig,
    boot_id: u64,
    mut report: impl FnMut(BridgeReport),
    stop: impl Future<Output = ()>,
) -> Result<(), BridgeError> {
    let (news_sender, mut news) = mpsc::channel(NEWS_MAX);
    if let Some(address) = config.vendor.listen {
        let listener = listen(address).await?;
        report(BridgeReport::VendorListening(listener.local_addr().unwrap_or(address)));
        let name = |stream, _| News::VendorConnected(stream);
        tokio::spawn(accept(listener, news_sender.clone(), name));
    }
    let mut shell = Shell {
        bridge: Bridge::new(&config, boot_id),
        config,
        began: Instant::now(),
        clients: BTreeMap::new(),
        next_connection: 1,
        vendor: Vendor::default(),
        news: news_sender,
    };
    tokio::pin!(stop);
    let mut is_listening = false;
    loop {
        shell.carry_out(&mut report);
        if shell.bridge.is_ready() && !is_listening {
            is_listening = true;
            let listener = listen(shell.config.listen).await?;
            report(BridgeReport::Listening(
                listener.local_addr().unwrap_or(shell.config.listen),
            ));
            tokio::spawn(accept(listener, shell.news.clone(), News::Connected));
        }
        let wake = shell
            .bridge
            .wake_at()
            .map(|at| shell.began + std::time::Duration::from_nanos(at.ns));
        tokio::select! {
            Some(news) = news.recv() => shell.handle(news),
            () = sleep_until(wake) => {
                let now = shell.now();
                shell.bridge.handle_wake(now);
            }
            () = &mut stop => break,
        }
    }
    let now = shell.now();
    shell.bridge.shut_down(now);
    shell.carry_out(&mut report);
    shell.finish().await;
    Ok(())
}

/// What has happened.
enum News {
    Connected(TcpStream, SocketAddr),
    Bytes(ConnectionId, Vec<u8>),
    Written(ConnectionId, usize),
    Closed(ConnectionId),
    VendorConnected(TcpStream),
    VendorLine(u64, String),
    VendorEnded(u64, String),
    Picture(u32, Result<Picture, FrameError>),
}

struct Shell {
    bridge: Bridge,
    config: BridgeConfig,
    began: Instant,
    clients: BTreeMap<ConnectionId, Client>,
    next_connection: u64,
    vendor: Vendor,
    news: mpsc::Sender<News>,
}

impl Shell {
    fn now(&self) -> Stamp {
        Stamp {
            ns: u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX),
        }
    }

    fn handle(&mut self, news: News) {
        let now = self.now();
        match news {
            News::Connected(stream, address) => {
                let id = ConnectionId(self.next_connection);
                self.next_connection += 1;
                self.clients.insert(id, Client::new(id, stream, self.news.clone()));
                self.bridge.handle_connected(now, id, &address.to_string());
            }
            News::Bytes(id, bytes) => self.bridge.handle_bytes(now, id, &bytes),
            News::Written(id, byte_count) => self.bridge.handle_written(now, id, byte_count),
            News::Closed(id) => {
                self.clients.remove(&id);
                self.bridge.handle_closed(now, id);
            }
            News::VendorConnected(stream) => {
                self.vendor.take_stream(stream, &self.news);
                self.bridge.handle_vendor_started(now);
            }
            News::VendorLine(generation, line) if self.vendor.is(generation) => self.bridge.handle_line(now, &line),
            News::VendorEnded(generation, reason) if self.vendor.is(generation) => {
                self.vendor = self.vendor.after_end();
                self.bridge.handle_vendor_ended(now, &reason);
            }
            // Of a vendor's side that has been replaced.
            News::VendorLine(..) | News::VendorEnded(..) => {}
            News::Picture(acquisition, picture) => self.bridge.handle_picture(now, acquisition, picture),
        }
    }

    /// Does what the bridge wants.
    fn carry_out(&mut self, report: &mut impl FnMut(BridgeReport)) {
        while let Some(output) = self.bridge.poll_output() {
            match output {
                BridgeOutput::Bytes { connection, bytes } => {
                    let queued = self.clients.get(&connection).is_none_or(|client| client.send(bytes));
                    if !queued {
                        self.drop_client(connection);
                    }
                }
                BridgeOutput::Close { connection } => self.drop_client(connection),
                BridgeOutput::Line(line) => self.vendor.say(line),
                BridgeOutput::Convert(conversion) => {
                    let (folder, news) = (self.config.vendor.frames.clone(), self.news.clone());
                    let keep = self.config.vendor.keep_frames;
                    tokio::task::spawn_blocking(move || {
                        let picture = files::convert(&conversion, &folder, keep);
                        news.blocking_send(News::Picture(conversion.files.acquisition, picture))
                            .ok();
                    });
                }
                BridgeOutput::StartVendor => {
                    if let Some(command) = &self.config.vendor.command
                        && let Err(error) = self.vendor.start(command, &self.news)
                    {
                        report(BridgeReport::Note(format!("cannot start {}: {error}", command[0])));
                        let now = self.now();
                        self.bridge.handle_vendor_ended(now, "it could not be started");
                    }
                }
                BridgeOutput::Note(text) => report(BridgeReport::Note(text)),
            }
        }
    }

    /// Ends a connection after what was sent on it.
    fn drop_client(&mut self, connection: ConnectionId) {
        self.clients.remove(&connection);
        let now = self.now();
        self.bridge.handle_closed(now, connection);
    }

    /// Lets the last bytes out and the vendor's side end.
    async fn finish(self) {
        drop(self.clients);
        self.vendor.finish().await;
    }
}

async fn listen(address: SocketAddr) -> Result<TcpListener, BridgeError> {
    TcpListener::bind(address)
        .await
        .map_err(|source| BridgeError::Listen { address, source })
}

async fn accept(listener: TcpListener, news: mpsc::Sender<News>, name: fn(TcpStream, SocketAddr) -> News) {
    while !news.is_closed() {
        match listener.accept().await {
            Ok((stream, address)) => {
                stream.set_nodelay(true).ok();
                if news.send(name(stream, address)).await.is_err() {
                    return;
                }
            }
            // Out of file handles, most likely: the connections that are open go on.
            Err(_) => tokio::time::sleep(ACCEPT_PAUSE).await,
        }
    }
}

async fn sleep_until(at: Option<Instant>) {
    match at {
        Some(at) => tokio::time::sleep_until(at).await,
        None => std::future::pending().await,
    }
}

const NEWS_MAX: usize = 256;
const ACCEPT_PAUSE: std::time::Duration = std::time::Duration::from_millis(100);
