//! One controller's or observer's TCP connection.

use super::News;
use crate::camera::bridge::ConnectionId;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::mpsc;

/// Dropping it closes the connection after what was queued.
pub(super) struct Client {
    outgoing: mpsc::Sender<Vec<u8>>,
}

impl Client {
    pub(super) fn new(id: ConnectionId, stream: TcpStream, news: mpsc::Sender<News>) -> Self {
        let (outgoing, queue) = mpsc::channel(QUEUE_MAX);
        let (reader, writer) = stream.into_split();
        tokio::spawn(serve(id, reader, writer, queue, news));
        Self { outgoing }
    }

    /// Queues bytes; `false` when the other side takes nothing and the queue is full.
    pub(super) fn send(&self, bytes: Vec<u8>) -> bool {
        self.outgoing.try_send(bytes).is_ok()
    }
}

async fn serve(
    id: ConnectionId,
    reader: OwnedReadHalf,
    writer: OwnedWriteHalf,
    queue: mpsc::Receiver<Vec<u8>>,
    news: mpsc::Sender<News>,
) {
    let mut reading = tokio::spawn(read(id, reader, news.clone()));
    let writing = write(id, writer, queue, &news);
    tokio::pin!(writing);
    tokio::select! {
        _ = &mut reading => {
            news.send(News::Closed(id)).await.ok();
        }
        () = &mut writing => {
            // Closed from this side. What still comes is read a while, so that our last bytes are not thrown away by a reset.
            tokio::time::timeout(LINGER, &mut reading).await.ok();
            reading.abort();
        }
    }
}

/// Reports what comes, until the other side ends. After an end from this side nobody looks at it.
async fn read(id: ConnectionId, mut reader: OwnedReadHalf, news: mpsc::Sender<News>) {
    let mut buffer = vec![0u8; READ_BYTES];
    loop {
        match reader.read(&mut buffer).await {
            Ok(0) | Err(_) => return,
            Ok(length) => {
                if news.send(News::Bytes(id, buffer[..length].to_vec())).await.is_err() {
                    return;
                }
            }
        }
    }
}

/// Writes what is queued until the queue is dropped or the other side takes nothing more.
async fn write(
    id: ConnectionId,
    mut writer: OwnedWriteHalf,
    mut queue: mpsc::Receiver<Vec<u8>>,
    news: &mpsc::Sender<News>,
) {
    while let Some(bytes) = queue.recv().await {
        if writer.write_all(&bytes).await.is_err() {
            // The reader reports the end.
            return std::future::pending().await;
        }
        news.send(News::Written(id, bytes.len())).await.ok();
    }
    writer.shutdown().await.ok();
}

/// Messages queued for one client: chunks are held back long before.
const QUEUE_MAX: usize = 256;
const READ_BYTES: usize = 16 << 10;
const LINGER: Duration = Duration::from_secs(2);
