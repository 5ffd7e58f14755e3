//! The vendor's side: a child process, or a program that connects.

use super::News;
use crate::camera::bridge::LINE_BYTES_MAX;
use std::io;
use std::process::Stdio;
use std::time::Duration;
use tokio::io::{AsyncBufRead, AsyncBufReadExt as _, AsyncRead, AsyncWrite, AsyncWriteExt as _, BufReader};
use tokio::net::TcpStream;
use tokio::process::{Child, Command};
use tokio::sync::mpsc;

/// Whoever speaks the lines now; each one has a generation of its own, so that late lines of the last are known.
#[derive(Default)]
pub(super) struct Vendor {
    generation: u64,
    lines: Option<mpsc::Sender<String>>,
    child: Option<Child>,
}

impl Vendor {
    pub(super) fn is(&self, generation: u64) -> bool {
        self.generation == generation && self.lines.is_some()
    }

    /// Nobody, with the generation that the last one had.
    pub(super) fn after_end(&self) -> Self {
        Self {
            generation: self.generation,
            lines: None,
            child: None,
        }
    }

    /// Starts the child process; one that still runs is ended.
    pub(super) fn start(&mut self, command: &[String], news: &mpsc::Sender<News>) -> io::Result<()> {
        let (program, arguments) = command.split_first().ok_or(io::ErrorKind::InvalidInput)?;
        *self = self.after_end();
        let mut started = Command::new(program);
        started
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .kill_on_drop(true);
        // Ctrl-C is for the bridge to handle, which tells its vendor's side to end.
        #[cfg(unix)]
        started.process_group(0);
        let mut child = started.spawn()?;
        let missing = || io::Error::other("a pipe to it is missing");
        let stdin = child.stdin.take().ok_or_else(missing)?;
        let stdout = child.stdout.take().ok_or_else(missing)?;
        self.child = Some(child);
        self.speak(BufReader::new(stdout), stdin, news);
        Ok(())
    }

    /// Speaks with a program that has connected; the last one is cut off.
    pub(super) fn take_stream(&mut self, stream: TcpStream, news: &mpsc::Sender<News>) {
        *self = self.after_end();
        let (reader, writer) = stream.into_split();
        self.speak(BufReader::new(reader), writer, news);
    }

    fn speak(
        &mut self,
        reader: BufReader<impl AsyncRead + Unpin + Send + 'static>,
        mut writer: impl AsyncWrite + Unpin + Send + 'static,
        news: &mpsc::Sender<News>,
    ) {
        self.generation += 1;
        let (lines, mut queue) = mpsc::channel::<String>(QUEUE_MAX);
        self.lines = Some(lines);
        tokio::spawn(listen(self.generation, reader, news.clone()));
        tokio::spawn(async move {
            while let Some(line) = queue.recv().await {
                // Who no longer listens has ended: the reader reports it.
                if writer.write_all(format!("{line}\n").as_bytes()).await.is_err() || writer.flush().await.is_err() {
                    return;
                }
            }
            writer.shutdown().await.ok();
        });
    }

    /// Queues a line. One that does not read its lines loses them; its acquisitions time out.
    pub(super) fn say(&self, line: String) {
        if let Some(lines) = &self.lines {
            lines.try_send(line).ok();
        }
    }

    /// Lets it end: its input does.
    pub(super) async fn finish(mut self) {
        self.lines = None;
        if let Some(mut child) = self.child
            && tokio::time::timeout(END_TIMEOUT, child.wait()).await.is_err()
        {
            child.kill().await.ok();
        }
    }
}

async fn listen(generation: u64, mut reader: BufReader<impl AsyncRead + Unpin>, news: mpsc::Sender<News>) {
    let reason = loop {
        match bounded_line(&mut reader).await {
            Ok(Some(line)) => {
                if news.send(News::VendorLine(generation, line)).await.is_err() {
                    return;
                }
            }
            Ok(None) => break "its output ended".to_owned(),
            Err(error) => break error.to_string(),
        }
    };
    news.send(News::VendorEnded(generation, reason)).await.ok();
}

/// One line without its end; `None` at the end of the stream. A longer one than lines may be is an error.
async fn bounded_line(reader: &mut (impl AsyncBufRead + Unpin)) -> io::Result<Option<String>> {
    let mut line = Vec::new();
    loop {
        let found = reader.fill_buf().await?;
        if found.is_empty() {
            // Half a line at the end was never finished.
            return Ok(None);
        }
        let end = found.iter().position(|&byte| byte == b'\n');
        let taken = end.unwrap_or(found.len());
        if line.len() + taken > LINE_BYTES_MAX {
            return Err(io::Error::other("a line that does not end"));
        }
        line.extend_from_slice(&found[..taken]);
        reader.consume(end.map_or(taken, |end| end + 1));
        if end.is_some() {
            return Ok(Some(String::from_utf8_lossy(&line).into_owned()));
        }
    }
}

const QUEUE_MAX: usize = 64;
const END_TIMEOUT: Duration = Duration::from_secs(10);
