//! The operator's words while a run goes on: Ctrl-C, and lines on standard input.

use crate::controller::Command;
use crate::run::Voice;
use std::io::BufRead as _;
use tokio::sync::mpsc;

/// Listens until the receiver is dropped. Ctrl-C holds, or aborts while the arm is held; [`KEYS`] with Enter say the rest, and any
/// other line lists them through `voice`. Termination by the system aborts.
pub(super) fn listen(voice: Voice) -> mpsc::Receiver<Command> {
    let (sender, receiver) = mpsc::channel(8);
    tokio::spawn(listen_to_signals(sender.clone()));
    // A thread of its own: reading a terminal cannot be interrupted, and must not keep the program from ending.
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let Ok(line) = line else { return };
            match command_of(line.trim()) {
                Some(command) if sender.blocking_send(command).is_err() => return,
                Some(_) => {}
                None => voice.say(&keys_in_words()),
            }
        }
    });
    receiver
}

/// What each key with Enter means.
const KEYS: [(&str, Command, &str); 5] = [
    ("h", Command::Hold, "hold"),
    ("v", Command::HoldAfterView, "hold after this view"),
    ("s", Command::Step, "one view, then hold"),
    ("r", Command::Resume, "resume"),
    ("a", Command::Abort, "abort"),
];

fn command_of(word: &str) -> Option<Command> {
    KEYS.iter()
        .find(|(key, ..)| *key == word)
        .map(|(_, command, _)| *command)
}

fn keys_in_words() -> String {
    let keys: Vec<String> = KEYS.iter().map(|(key, _, words)| format!("{key}: {words}")).collect();
    format!(
        "With Enter, {}   ?: this list.   Ctrl-C: hold, then abort",
        keys.join("   ")
    )
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_but_the_stop_key_has_a_key_and_the_list_names_it() {
        let by_key: Vec<Command> = KEYS.iter().filter_map(|(key, ..)| command_of(key)).collect();
        let expected: Vec<Command> = Command::ALL.into_iter().filter(|word| *word != Command::Stop).collect();
        assert_eq!(by_key, expected);
        let list = keys_in_words();
        assert!(
            KEYS.iter()
                .all(|(key, _, words)| list.contains(&format!("{key}: {words}")))
        );
        assert_eq!(command_of("?"), None);
    }
}
