//! The conversation with the camera bridge, as a value: bytes and time in, bytes and events out.
//!
//! Greeting, capabilities, settings (with the echo compared) and arming follow each other; then one acquisition at a time.
//! A frame is handed out only when every byte of it has been checked. The conversation outlives its connections:
//!
//! | what happens | what follows |
//! |---|---|
//! | the connection ends, falls silent or breaks the protocol | it is opened again, later each time, for `reconnect_timeout_ms`; the frame of an open acquisition is fetched, so that nothing is exposed twice |
//! | the bridge was started anew meanwhile (another `boot_id`) | the open acquisition is lost; settings and arming anew |
//! | an acquisition takes longer than predicted | ABORT, DISARM, CONFIGURE, ARM; without a reply, a new connection |
//! | the device is gone, starts anew, is too hot or in use | it is waited for, with a bound, then CONFIGURE and ARM |
//! | another camera answers, another echo, a refusal that waiting does not mend | the camera is given up |

mod clock;
mod flight;
mod hear;
mod link;
mod offered;
mod report;
#[cfg(test)]
mod tests;
mod trouble;

pub use clock::ClockEstimate;
pub use report::{CameraEvent, CameraOutput, ExchangeSettings, Opened, Trouble};

use crate::camera::message::{
    Arm, Bye, Caps, ClientMessage, ComponentKind, Configured, Greeting, Hello, TRIGGER_ALL, Trigger, TriggerId,
};
use crate::camera::settings::CameraSettings;
use crate::seed::{Seed, Stream};
use crate::stamp::{Stamp, earlier};
use clock::Clock;
use flight::Flight;
use link::Link;
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use trouble::{Outage, Patience};

/// The conversation.
#[derive(Debug)]
pub struct Exchange {
    times: ExchangeSettings,
    run_id: u64,
    /// For the pauses between attempts to connect.
    chance: ChaCha8Rng,
    /// Every setting that the run will ask for, checked against the capabilities in the opening.
    planned: Vec<CameraSettings>,
    wanted: CameraSettings,
    /// What the last CONFIGURE asked for.
    asked: CameraSettings,
    stage: Stage,
    link: Link,
    /// The open acquisition, whatever becomes of the connection.
    flight: Option<Flight>,
    /// Connections that ended during an acquisition since the last whole frame.
    broken_transfers: u32,
    outage: Option<Outage>,
    patience: Option<Patience>,
    /// The bound of the last wait, until a trigger is taken or the camera has been armed for a while.
    patience_until: Option<Stamp>,
    /// Attempts to bring a server that is in an unexpected state back, since it was last armed.
    remedies: u32,
    greeting: Option<Greeting>,
    caps: Option<Caps>,
    /// What is in force, as far as it can be relied on.
    in_force: Option<Configured>,
    armed: bool,
    armed_since: Stamp,
    /// Whether [`CameraEvent::Ready`] has been said.
    presented: bool,
    clock: Clock,
    outbox: VecDeque<CameraOutput>,
    events: VecDeque<CameraEvent>,
}

/// Where the connection stands.
#[derive(Debug, Clone, Copy)]
enum Stage {
    Apart,
    Connecting {
        due: Stamp,
    },
    /// A request is out whose reply decides what comes next.
    Asking {
        request: Request,
        request_id: u32,
        due: Stamp,
    },
    /// The device cannot be used; CONFIGURE is said again at this time.
    Waiting {
        again: Stamp,
    },
    /// Armed, or an acquisition is open.
    Standing,
    /// Without a connection until then.
    Away {
        again: Stamp,
    },
    Leaving {
        due: Stamp,
    },
    Over,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Request {
    Hello,
    Caps,
    Fetch,
    Abort,
    Disarm,
    Configure,
    Arm,
}

impl Exchange {
    /// A conversation that has not begun, in the run of this id. `planned` are all settings that will be wanted, at least
    /// one; the first are asked for first.
    pub fn new(times: ExchangeSettings, run_id: u64, seed: Seed, planned: Vec<CameraSettings>) -> Self {
        let wanted = *planned.first().expect("a run wants at least one setting of the camera");
        Self {
            times,
            run_id,
            chance: seed.stream(Stream::Reconnecting),
            planned,
            wanted,
            asked: wanted,
            stage: Stage::Apart,
            link: Link::default(),
            flight: None,
            broken_transfers: 0,
            outage: None,
            patience: None,
            patience_until: None,
            remedies: 0,
            greeting: None,
            caps: None,
            in_force: None,
            armed: false,
            armed_since: Stamp::START,
            presented: false,
            clock: Clock::default(),
            outbox: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// Opens the conversation.
    pub fn open(&mut self, now: Stamp) {
        self.connect(now);
    }

    /// Another process goes on with the run: no connection is left, and the frame of an open acquisition is fetched once
    /// there is one. It must be the same camera. Call [`Self::open`] next.
    pub fn restart(&mut self) {
        if let Some(flight) = &mut self.flight {
            flight.interrupt();
        }
        self.stage = Stage::Apart;
        self.broken_transfers = 0;
        self.remedies = 0;
        (self.outage, self.patience, self.patience_until) = (None, None, None);
        (self.in_force, self.armed, self.presented) = (None, false, false);
        self.clock = Clock::default();
        self.outbox.clear();
        self.events.clear();
    }

    /// The open acquisition is of no use any more.
    pub fn forget_open(&mut self) {
        self.flight = None;
    }

    /// These settings are wanted from now on. They are brought into force as soon as no acquisition is open.
    pub fn want(&mut self, now: Stamp, wanted: CameraSettings) {
        self.wanted = wanted;
        if matches!(self.stage, Stage::Standing) && self.flight.is_none() && !self.is_armed() {
            self.go_on(now);
        }
    }

    /// Starts one acquisition. Only when [`Self::is_armed`].
    pub fn trigger(&mut self, now: Stamp, trigger_id: TriggerId) {
        let Some(in_force) = self.in_force else {
            return self.note(format!("trigger {:#x} without settings in force", trigger_id.0));
        };
        let request_id = self.say_act(&ClientMessage::Trigger(Trigger {
            trigger_id,
            view_id: trigger_id.view_index(),
            config_id: in_force.config_id,
            deadline_ms: 0,
            tag: format!("view {} attempt {}", trigger_id.view_index(), trigger_id.attempt()),
        }));
        self.flight = Some(Flight::begin(now, trigger_id, request_id, &in_force));
    }

    /// Says goodbye (aborting what is in flight) and closes. Does nothing when the conversation is over already.
    pub fn leave(&mut self, now: Stamp) {
        match self.stage {
            Stage::Apart | Stage::Over | Stage::Leaving { .. } => return,
            Stage::Connecting { .. } | Stage::Away { .. } => {
                if matches!(self.stage, Stage::Connecting { .. }) {
                    self.outbox.push_back(CameraOutput::Close);
                }
                self.stage = Stage::Over;
                self.events.push_back(CameraEvent::Left);
                return;
            }
            Stage::Asking { .. } | Stage::Waiting { .. } | Stage::Standing => {}
        }
        if self.flight.take().is_some() {
            self.say(&ClientMessage::Abort {
                trigger_id: TRIGGER_ALL,
            });
        }
        if self.armed {
            self.say(&ClientMessage::Disarm);
        }
        self.say_goodbye(Bye::DONE, "done");
        self.outbox.push_back(CameraOutput::Close);
        self.stage = Stage::Leaving {
            due: now.plus_ms(LEAVE_MS),
        };
    }

    /// Whether a trigger would be taken now, with the settings that are wanted.
    pub fn is_armed(&self) -> bool {
        matches!(self.stage, Stage::Standing)
            && self.flight.is_none()
            && self.armed
            && self.in_force.is_some_and(|in_force| in_force.settings == self.to_ask())
    }

    /// Whether the conversation is over.
    pub fn is_over(&self) -> bool {
        matches!(self.stage, Stage::Apart | Stage::Over)
    }

    /// How the device's clock stands to the run's; `None` before the first answer.
    pub fn clock(&self) -> Option<ClockEstimate> {
        self.clock.estimate()
    }

    /// The TCP connection stands.
    pub fn handle_connected(&mut self, now: Stamp) {
        if !matches!(self.stage, Stage::Connecting { .. }) {
            return;
        }
        self.link = Link::begun(now, self.times.ping_interval_ms);
        self.ask(now, Request::Hello);
    }

    /// The TCP connection did not come about, or has ended.
    pub fn handle_closed(&mut self, now: Stamp, reason: &str) {
        match self.stage {
            Stage::Apart | Stage::Over | Stage::Away { .. } => {}
            Stage::Leaving { .. } => {
                self.stage = Stage::Over;
                self.events.push_back(CameraEvent::Left);
            }
            Stage::Connecting { .. } => self.break_off(now, Trouble::Unreachable(reason.to_owned())),
            Stage::Asking { .. } | Stage::Waiting { .. } | Stage::Standing => {
                self.break_off(now, Trouble::Closed(reason.to_owned()));
            }
        }
    }

    /// Bytes have come.
    pub fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        // What was on its way when we said goodbye changes nothing.
        if !self.is_connected() {
            return;
        }
        self.link.last_heard = now;
        let mut reader = std::mem::take(&mut self.link.reader);
        reader.push(bytes);
        while self.is_connected() {
            match reader.next_frame() {
                Ok(None) => {
                    self.link.reader = reader;
                    return;
                }
                Ok(Some(frame)) => self.handle_frame(now, &frame),
                Err(error) => self.accuse(now, error.code(), error.to_string()),
            }
        }
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        match self.stage {
            Stage::Connecting { due } if due <= now => {
                let seconds = self.times.connect_timeout_ms as f64 * 1e-3;
                self.break_off(now, Trouble::Unreachable(format!("no connection within {seconds} s")));
            }
            Stage::Asking { request, due, .. } if due <= now => {
                let reason = format!("no reply to {request:?} within {} ms", self.times.reply_timeout_ms);
                self.break_off(now, Trouble::Silent(reason));
            }
            Stage::Away { again } if again <= now => self.connect(now),
            Stage::Waiting { again } if again <= now => self.try_device_again(now),
            Stage::Standing => self.handle_late_flight(now),
            Stage::Leaving { due } if due <= now => {
                self.stage = Stage::Over;
                self.events.push_back(CameraEvent::Left);
            }
            _ => {}
        }
        if self.is_connected() {
            self.watch_connection(now);
        }
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        let alive = self.link.wake_at(self.times.dead_after_ms);
        match self.stage {
            Stage::Apart | Stage::Over => None,
            Stage::Connecting { due } | Stage::Leaving { due } | Stage::Away { again: due } => Some(due),
            Stage::Asking { due, .. } | Stage::Waiting { again: due } => Some(due.min(alive)),
            Stage::Standing => earlier(self.flight.as_ref().map(Flight::due), Some(alive)),
        }
    }

    /// The next thing the shell must do.
    #[must_use]
    pub fn poll_output(&mut self) -> Option<CameraOutput> {
        self.outbox.pop_front()
    }

    /// The next event.
    #[must_use]
    pub fn poll_event(&mut self) -> Option<CameraEvent> {
        self.events.pop_front()
    }

    fn connect(&mut self, now: Stamp) {
        self.stage = Stage::Connecting {
            due: now.plus_ms(self.times.connect_timeout_ms),
        };
        self.outbox.push_back(CameraOutput::Connect);
    }

    /// Takes the next step towards being armed with the wanted settings, unless an acquisition is open.
    fn go_on(&mut self, now: Stamp) {
        if self.flight.is_some() {
            self.stage = Stage::Standing;
            return;
        }
        if self.patience.as_ref().is_some_and(Patience::is_for_device) {
            return self.wait(now);
        }
        let wanted = self.to_ask();
        match self.in_force {
            Some(in_force) if in_force.settings == wanted && self.armed => self.stand(),
            Some(in_force) if in_force.settings == wanted => self.ask(now, Request::Arm),
            _ if self.armed => self.ask(now, Request::Disarm),
            _ => self.ask(now, Request::Configure),
        }
    }

    /// Armed with the wanted settings.
    fn stand(&mut self) {
        self.stage = Stage::Standing;
        self.remedies = 0;
        let waited = self.patience.take();
        if let Some(patience) = &waited {
            self.patience_until = Some(patience.until());
        }
        if self.presented {
            if waited.is_some() {
                self.events.push_back(CameraEvent::Rearmed);
            }
            return;
        }
        self.presented = true;
        let missing = "the opening went through every stage";
        self.events.push_back(CameraEvent::Ready(Box::new(Opened {
            greeting: self.greeting.clone().expect(missing),
            caps: self.caps.clone().expect(missing),
            configured: self.in_force.expect(missing),
        })));
    }

    fn ask(&mut self, now: Stamp, request: Request) {
        let config_id = self.in_force.map_or(0, |in_force| in_force.config_id);
        if request == Request::Configure {
            self.asked = self.to_ask();
        }
        let request_id = self.say(&match request {
            Request::Hello => ClientMessage::Hello(Hello::controller(self.run_id, "bladescan")),
            Request::Caps => ClientMessage::GetCaps,
            Request::Fetch => {
                let flight = self
                    .flight
                    .as_ref()
                    .expect("only the frame of an open acquisition is fetched");
                ClientMessage::Fetch {
                    trigger_id: flight.trigger_id(),
                }
            }
            Request::Abort => ClientMessage::Abort {
                trigger_id: TRIGGER_ALL,
            },
            Request::Disarm => ClientMessage::Disarm,
            Request::Configure => ClientMessage::Configure(self.asked),
            Request::Arm => ClientMessage::Arm(Arm {
                mode: Arm::SOFTWARE,
                config_id,
            }),
        });
        self.stage = Stage::Asking {
            request,
            request_id,
            due: now.plus_ms(self.times.reply_timeout_ms),
        };
    }

    /// The wanted settings, and the matching scores where the camera offers them.
    fn to_ask(&self) -> CameraSettings {
        let offered = self.caps.as_ref().map_or(0, |caps| caps.components);
        CameraSettings {
            components: self.wanted.components | offered & ComponentKind::Confidence.bit(),
            ..self.wanted
        }
    }

    fn is_asking(&self, wanted: Request, reply_to: u32) -> bool {
        matches!(self.stage, Stage::Asking { request, request_id, .. } if request == wanted && request_id == reply_to)
    }

    /// Whether messages of the server still count.
    fn is_connected(&self) -> bool {
        matches!(
            self.stage,
            Stage::Asking { .. } | Stage::Waiting { .. } | Stage::Standing
        )
    }

    fn note(&mut self, text: String) {
        self.events.push_back(CameraEvent::Note(text));
    }
}

const LEAVE_MS: u64 = 1000;

/// The components every configuration asks for.
pub const COMPONENTS_WANTED: u32 = ComponentKind::WANTED;
