//! What came in over all connections, on its way to whoever makes frames of it.

use super::content::Content;
use super::message::Message;
use super::stream::Step;
use crate::Error;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Bytes of messages that wait, at most. A connection that brings more is not read until there is room.
const MAX_WAITING_BYTES: usize = 1 << 27;

/// What came in.
#[derive(Debug)]
pub(super) enum Incoming {
    Message(Message),
    /// Something that was left out, or a connection that was lost.
    Fault(Error),
}

impl Incoming {
    /// Bytes in memory, roughly.
    fn bytes(&self) -> usize {
        /// Of one without a content.
        const LEAST: usize = 256;
        let Incoming::Message(Message { metadata, content, .. }) = self else { return LEAST };
        let metadata = metadata.iter().map(|(key, value)| 48 + key.len() + value.len()).sum::<usize>();
        let content = match content {
            Content::Tracking(tools) => tools.len() * 96,
            Content::Image(image) => image.pixels.len(),
            Content::Points(points) => points.len() * 12,
            Content::PolyData(data) => {
                let cells = data.lines.iter().chain(&data.polygons).chain(&data.strips);
                data.points_mm.len() * 12 * (1 + data.scalars.len())
                    + cells.map(|cell| 24 + 4 * cell.len()).sum::<usize>()
            }
            Content::Text(text) => text.len(),
            Content::Status(status) => status.message.len(),
            Content::Transform(_) | Content::StartTracking(_) | Content::GetStatus => 0,
        };
        LEAST + metadata + content
    }
}

/// What connections brought.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct Traffic {
    /// Connections that were made.
    pub connections: usize,
    /// Connections that ended or were lost.
    pub connections_ended: usize,
    /// Messages that were read.
    pub messages: usize,
    /// Messages of kinds that are not known, which were skipped.
    pub unknown: usize,
    /// Messages that are not what they should be, which were skipped.
    pub refused: usize,
}

#[derive(Debug, Default)]
struct State {
    waiting: VecDeque<Incoming>,
    bytes: usize,
    senders: usize,
    stopped: bool,
    traffic: Traffic,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

/// A lock whose holder panicked is as good as any: no state here is left half changed.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The end that is read.
#[derive(Debug, Clone, Default)]
pub(super) struct Queue(Arc<Shared>);

/// An end that is written. The queue has ended when the last one is dropped and all is read.
#[derive(Debug)]
pub(super) struct Sender(Arc<Shared>);

impl Queue {
    pub fn sender(&self) -> Sender {
        lock(&self.0.state).senders += 1;
        Sender(Arc::clone(&self.0))
    }

    /// The next that came in; waits for it. `None`: the queue has ended, or was stopped.
    pub fn next(&self) -> Option<Incoming> {
        let mut state = lock(&self.0.state);
        loop {
            if state.stopped {
                return None;
            }
            if let Some(next) = state.waiting.pop_front() {
                state.bytes -= next.bytes();
                self.0.changed.notify_all();
                return Some(next);
            }
            if state.senders == 0 {
                return None;
            }
            state = self.0.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Ends the queue: what waits is lost, and no sender waits any longer.
    pub fn stop(&self) {
        let mut state = lock(&self.0.state);
        state.stopped = true;
        state.waiting.clear();
        state.bytes = 0;
        self.0.changed.notify_all();
    }

    pub fn traffic(&self) -> Traffic {
        lock(&self.0.state).traffic.clone()
    }
}

impl Sender {
    /// Gives something to the queue; waits for room. `false`: nobody reads it any more.
    pub fn send(&self, incoming: Incoming) -> bool {
        let bytes = incoming.bytes();
        let mut state = lock(&self.0.state);
        while !state.stopped && state.bytes > 0 && state.bytes + bytes > MAX_WAITING_BYTES {
            state = self.0.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if state.stopped {
            return false;
        }
        state.bytes += bytes;
        state.waiting.push_back(incoming);
        self.0.changed.notify_all();
        true
    }

    /// Gives what a reader came to; see [`send`](Self::send).
    pub fn take(&self, step: Step) -> bool {
        match step {
            Step::Message(message) => {
                self.count(|traffic| traffic.messages += 1);
                self.send(Incoming::Message(message))
            }
            Step::Unknown => {
                self.count(|traffic| traffic.unknown += 1);
                true
            }
            Step::Refused(error) => {
                self.count(|traffic| traffic.refused += 1);
                self.send(Incoming::Fault(error))
            }
            Step::Lost(error) => self.send(Incoming::Fault(error)),
            Step::Silent | Step::Closed(_) => true,
        }
    }

    pub fn count(&self, count: impl FnOnce(&mut Traffic)) {
        count(&mut lock(&self.0.state).traffic);
    }

    pub fn is_stopped(&self) -> bool {
        lock(&self.0.state).stopped
    }

    /// Waits for some time, or until the queue is stopped.
    pub fn wait(&self, time: Duration) {
        let end = Instant::now() + time;
        let mut state = lock(&self.0.state);
        while !state.stopped {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            let waited = self.0.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Clone for Sender {
    fn clone(&self) -> Self {
        Queue(Arc::clone(&self.0)).sender()
    }
}

impl Drop for Sender {
    fn drop(&mut self) {
        lock(&self.0.state).senders -= 1;
        self.0.changed.notify_all();
    }
}
