//! The operator's words while a run goes on: Ctrl-C, and lines on standard input.

use crate::controller::Command;
use std::io::BufRead as _;
use tokio::sync::mpsc;

/// Listens until the receiver is dropped. Ctrl-C holds, or aborts while the arm is held; `h`, `r` and `a` with Enter hold,
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
    loop {
        let command = tokio::select! {
            result = tokio::signal::ctrl_c() => match result {
                Ok(()) => Command::Stop,
                Err(_) => return,
            },
            () = terminated() => Command::Abort,
        };
        if sender.send(command).await.is_err() {
            return;
        }
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
