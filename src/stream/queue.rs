//! Frames that have come and wait to be taken.

use crate::Error;
use crate::recording::Frame;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// What to do with a frame for which there is no room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WhenFull {
    /// Its sender waits: no frame is lost.
    Wait,
    /// The oldest frame that waits is dropped: what is shown is never older than the queue is long.
    DropOldest,
}

/// A bounded queue between the threads that receive frames and the one that takes them. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Queue {
    shared: Arc<(Mutex<State>, Condvar)>,
    capacity: usize,
    when_full: WhenFull,
}

#[derive(Debug, Default)]
struct State {
    frames: VecDeque<(Frame, Instant)>,
    dropped: usize,
    faults: Faults,
    ended: Option<Option<Error>>,
    closed: bool,
}

/// What came and was no frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Faults {
    pub count: usize,
    /// The first of them, for people.
    pub first: Vec<String>,
}

impl Faults {
    /// Faults whose text is kept.
    const LISTED: usize = 10;

    pub(crate) fn add(&mut self, text: String) {
        self.count += 1;
        if self.first.len() < Self::LISTED {
            self.first.push(text);
        }
    }
}

/// What a queue has.
#[derive(Debug)]
pub(crate) enum Next {
    /// A frame, and when it came.
    Frame(Box<Frame>, Instant),
    /// Nothing came in the time given.
    Idle,
    /// Nothing will come any more, because of an error where there is one.
    Ended(Option<Error>),
}

impl Queue {
    pub(crate) fn new(capacity: usize, when_full: WhenFull) -> Self {
        Self { shared: Arc::default(), capacity: capacity.max(1), when_full }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.shared.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a frame that came now. Returns whether anyone will take it: if not, its thread can end.
    pub(crate) fn push(&self, frame: Frame) -> bool {
        let came = Instant::now();
        let mut state = self.state();
        while state.frames.len() >= self.capacity && !state.closed {
            match self.when_full {
                WhenFull::DropOldest => {
                    state.frames.pop_front();
                    state.dropped += 1;
                }
                WhenFull::Wait => {
                    state = self.shared.1.wait(state).unwrap_or_else(PoisonError::into_inner);
                }
            }
        }
        if state.closed {
            return false;
        }
        state.frames.push_back((frame, came));
        self.shared.1.notify_all();
        true
    }

    /// Counts something that came and was no frame.
    pub(crate) fn fault(&self, text: String) {
        self.state().faults.add(text);
    }

    /// Says that nothing more will come.
    pub(crate) fn end(&self, error: Option<Error>) {
        self.state().ended.get_or_insert(error);
        self.shared.1.notify_all();
    }

    /// Takes no more frames; those who wait with one go on.
    pub(crate) fn close(&self) {
        self.state().closed = true;
        self.shared.1.notify_all();
    }

    /// The oldest frame, after waiting for one at most so long.
    pub(crate) fn next(&self, within: Duration) -> Next {
        let empty = |state: &mut State| state.frames.is_empty() && state.ended.is_none();
        let (mut state, _) = self
            .shared
            .1
            .wait_timeout_while(self.state(), within, empty)
            .unwrap_or_else(PoisonError::into_inner);
        if let Some((frame, came)) = state.frames.pop_front() {
            self.shared.1.notify_all();
            return Next::Frame(Box::new(frame), came);
        }
        match &mut state.ended {
            Some(error) => Next::Ended(error.take()),
            None => Next::Idle,
        }
    }

    /// Frames that were dropped so far.
    pub(crate) fn dropped(&self) -> usize {
        self.state().dropped
    }

    /// What came so far and was no frame.
    pub(crate) fn faults(&self) -> Faults {
        self.state().faults.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    const NOW: Duration = Duration::ZERO;

    fn frame(number: usize) -> Frame {
        Frame::new(Pose::IDENTITY, Vec::new()).with_number(Some(number))
    }

    fn numbers(queue: &Queue) -> Vec<usize> {
        let next = || match queue.next(NOW) {
            Next::Frame(frame, _) => frame.number,
            Next::Idle | Next::Ended(_) => None,
        };
        std::iter::from_fn(next).collect()
    }

    #[test]
    fn a_full_queue_drops_the_oldest_or_lets_the_sender_wait() {
        let newest = Queue::new(3, WhenFull::DropOldest);
        assert!((0..10).all(|k| newest.push(frame(k))));
        assert_eq!((newest.dropped(), numbers(&newest)), (7, vec![7, 8, 9]));

        let all = Queue::new(3, WhenFull::Wait);
        let sender = std::thread::spawn({
            let all = all.clone();
            move || {
                let pushed = (0..100).all(|k| all.push(frame(k)));
                all.end(None);
                pushed
            }
        });
        let mut taken = Vec::new();
        loop {
            match all.next(Duration::from_secs(60)) {
                Next::Frame(frame, _) => taken.extend(frame.number),
                Next::Idle => panic!("nothing came"),
                Next::Ended(error) => break assert!(error.is_none()),
            }
        }
        assert!(sender.join().unwrap());
        assert_eq!((all.dropped(), taken), (0, (0..100).collect()));
    }

    #[test]
    fn what_came_before_the_end_is_taken_and_a_closed_queue_lets_go() {
        let queue = Queue::new(1, WhenFull::Wait);
        assert!(matches!(queue.next(NOW), Next::Idle));
        assert!(queue.push(frame(5)));
        queue.end(Some(Error::Cancelled));
        queue.end(None);
        assert_eq!(numbers(&queue), [5], "the end was told once all was taken");
        let waiting = std::thread::spawn({
            let queue = Queue { capacity: 1, ..queue.clone() };
            move || [queue.push(frame(6)), queue.push(frame(7))]
        });
        while queue.state().frames.is_empty() {
            std::thread::yield_now();
        }
        queue.close();
        assert!(!waiting.join().unwrap()[1]);
        (0..20).for_each(|k| queue.fault(format!("fault {k}")));
        let faults = queue.faults();
        assert_eq!((faults.count, faults.first.len(), faults.first[9].as_str()), (20, 10, "fault 9"));
    }
}
