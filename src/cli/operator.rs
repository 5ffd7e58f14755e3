//! The operator's words while a run goes on: Ctrl-C, and lines on standard input.

use crate::controller::Command;
use std::io::BufRead as _;
use tokio::sync::mpsc;

/// Listens until the receiver is dropped. The first Ctrl-C holds, the next one aborts; `h`, `r` and `a` with Enter hold,
/// resume and abort. Termination by the system aborts.
pub(super) fn listen() -> mpsc::Receiver<Command> {
    let (sender, receiver) = mpsc::channel(8);
    tokio::spawn(listen_to_signals(sender.clone()));
    // A thread of its own: reading a terminal cannot be interrupted, and must not keep the program from ending.
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let Ok(line) = line else { return };
            let command = match line.trim() {
                "h" => Command::Hold,
                "r" => Command::Resume,
                "a" => Command::Abort,
                _ => continue,
            };
            if sender.blocking_send(command).is_err() {
                return;
            }
        }
    });
    receiver
}

async fn listen_to_signals(sender: mpsc::Sender<Command>) {
    let mut command = Command::Hold;
    loop {
        let next = tokio::select! {
            result = tokio::signal::ctrl_c() => match result {
                Ok(()) => command,
                Err(_) => return,
            },
            () = terminated() => Command::Abort,
        };
        if sender.send(next).await.is_err() {
            return;
        }
        command = Command::Abort;
    }
}

#[cfg(unix)]
async fn terminated() {
    use tokio::signal::unix::{SignalKind, signal};
    match signal(SignalKind::terminate()) {
        Ok(mut signal) => {
            signal.recv().await;
        }
        Err(_) => std::future::pending().await,
    }
}

#[cfg(not(unix))]
async fn terminated() {
    std::future::pending().await
}
