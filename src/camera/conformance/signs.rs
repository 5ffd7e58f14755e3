//! Signs of life (sections 3.7 and 4.13).

use super::bench::{DEAD_MS, REPLY_MS, require, unexpected};
use super::{Clause, Needs, clause};
use crate::camera::lines::server_message;
use crate::camera::message::{Bye, ClientMessage, ServerMessage};

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Nothing,
        "4-pong",
        "PING is answered by PONG with the sender's clock as it came; the device's clock goes on",
        "PING twice, a tenth of a second apart",
        |bench| {
            let line = bench.controller()?;
            let mut device_ns = Vec::new();
            for sender_ns in [0x0123_4567_89AB_CDEF, 7] {
                let heard = bench.ask(line, &ClientMessage::Ping { sender_ns })?;
                let ServerMessage::Pong(pong) = server_message(&heard)? else {
                    return Err(unexpected("PONG", &heard));
                };
                require(pong.sender_ns == sender_ns, || {
                    format!("another clock came back: {heard}")
                })?;
                device_ns.push(pong.device_ns);
                bench.lines.pass(100);
            }
            let passed_ms = device_ns[1].saturating_sub(device_ns[0]) / 1_000_000;
            require((50..1000).contains(&passed_ms), || {
                format!("the device's clock went on by {passed_ms} ms in a tenth of a second: {device_ns:?}")
            })
        },
    ),
    clause(
        Needs::Nothing,
        "3.7-status",
        "STATUS comes by itself every second, to a controller and to an observer",
        "both listen for 5 s",
        |bench| {
            for line in [bench.controller()?, bench.observer()?] {
                let seen = bench.lines.line(line).statuses().len();
                bench.lines.pass(STATUS_MS);
                let state = bench.lines.line(line);
                let came: Vec<u64> = state.statuses()[seen..]
                    .iter()
                    .map(|status| status.at.ns / 1_000_000)
                    .collect();
                require((4..=6).contains(&came.len()), || {
                    format!("{} came within {STATUS_MS} ms, at {came:?} ms", came.len())
                })?;
            }
            Ok(())
        },
    ),
    clause(
        Needs::Nothing,
        "3.7-alive",
        "the server gives a sign of life at least every second",
        "a controller listens for 3 s",
        |bench| {
            let line = bench.controller()?;
            bench.lines.pass(3000);
            let longest_ms = bench.lines.line(line).longest_silence_ms();
            require(longest_ms <= 2000, || format!("nothing came for {longest_ms} ms"))
        },
    ),
    clause(
        Needs::Nothing,
        "3.7-dead",
        "a client that is silent for 5 s is dead: BYE 4, close; one that gives signs of life is not",
        "a controller falls silent; an observer goes on pinging",
        |bench| {
            let line = bench.controller()?;
            let observer = bench.observer()?;
            bench.lines.fall_silent(line);
            let began = bench.lines.now();
            bench
                .lines
                .hear_if(line, "BYE 4", DEAD_MS + REPLY_MS, |heard| heard.kind == 0x7F)?;
            let ms = bench.lines.now().ms_since(began);
            let bye = bench.lines.line(line).goodbye().map(|bye| bye.reason);
            require(bye == Some(Bye::TIMEOUT), || format!("BYE has the reason {bye:?}"))?;
            require((4000..=DEAD_MS).contains(&ms), || format!("BYE came after {ms} ms"))?;
            require(bench.lines.is_closed_within(line, REPLY_MS), || {
                "no close after BYE".into()
            })?;
            bench.state(observer).map(|_| ())
        },
    ),
];

const STATUS_MS: u64 = 5000;
