//! Where frames come from.

use super::queue::{Faults, Next, Queue};
use crate::openigtlink;
use crate::recording::{FRAME_INTERVAL_S, FrameLines, Recording};
use crate::{Error, Result};
use std::io::{BufRead, BufReader};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Frames, one after the other.
pub(crate) enum Source {
    /// All of a recording, at a pace.
    Recorded(Recorded),
    /// What threads receive.
    Queued(Queue),
}

/// The longest wait for a frame of a recording, s: gaps in its times are shortened to it.
const LONGEST_WAIT_S: f64 = 5.0;
/// How often whoever waits looks whether the run is to end.
const LOOK: Duration = Duration::from_millis(50);
/// Connections that may send at the same time.
const MAX_SENDERS: usize = 16;

/// A recording that is played.
pub(crate) struct Recorded {
    recording: Arc<Recording>,
    /// The place of the next frame.
    next: usize,
    /// How many times faster than it was recorded; `None`: as fast as it is taken.
    speed: Option<f64>,
    start: Option<Instant>,
    due_s: f64,
    before_s: Option<Option<f64>>,
}

impl Recorded {
    /// Plays the frames from the place `first` on.
    pub(crate) fn new(recording: Arc<Recording>, first: usize, speed: Option<f64>) -> Self {
        Self { recording, next: first, speed, start: None, due_s: 0.0, before_s: None }
    }

    /// The next frame, once it is due, and when that was; the end where that is asked for before.
    fn next(&mut self, is_ended: &dyn Fn() -> bool) -> Next {
        let Some(frame) = self.recording.frames.get(self.next) else { return Next::Ended(None) };
        let Some(speed) = self.speed else {
            self.next += 1;
            return Next::Frame(Box::new(frame.clone()), Instant::now());
        };
        let start = *self.start.get_or_insert_with(Instant::now);
        if let Some(before_s) = self.before_s {
            let step_s = frame.time_s.zip(before_s).map(|(now_s, before_s)| now_s - before_s);
            let step_s = step_s.filter(|s| s.is_finite()).unwrap_or(FRAME_INTERVAL_S);
            self.due_s += step_s.clamp(0.0, LONGEST_WAIT_S) / speed;
        }
        self.before_s = Some(frame.time_s);
        let due = start + Duration::from_secs_f64(self.due_s);
        while let Some(wait) = due.checked_duration_since(Instant::now()).filter(|wait| !wait.is_zero()) {
            if is_ended() {
                return Next::Ended(None);
            }
            std::thread::sleep(wait.min(LOOK));
        }
        self.next += 1;
        Next::Frame(Box::new(frame.clone()), due)
    }
}

impl Source {
    /// The next frame and when it came, or was due; [`Next::Idle`] where nothing comes for a moment.
    pub(crate) fn next(&mut self, is_ended: &dyn Fn() -> bool) -> Next {
        match self {
            Source::Recorded(recorded) => recorded.next(is_ended),
            Source::Queued(queue) => queue.next(LOOK),
        }
    }

    /// Frames that were dropped for newer ones.
    pub(crate) fn dropped(&self) -> usize {
        match self {
            Source::Recorded(_) => 0,
            Source::Queued(queue) => queue.dropped(),
        }
    }

    /// What came and was no frame.
    pub(crate) fn faults(&self) -> Faults {
        match self {
            Source::Recorded(_) => Faults::default(),
            Source::Queued(queue) => queue.faults(),
        }
    }
}

/// The error of a connection.
fn broken(address: impl ToString) -> impl FnOnce(std::io::Error) -> Error {
    move |source| Error::Connection { address: address.to_string(), source }
}

/// Puts the frames of a text into a queue, line by line. Returns whether to go on: not where nobody takes them.
fn pass_lines(reader: impl BufRead, from: &str, queue: &Queue) -> std::io::Result<bool> {
    for line in FrameLines::new(reader) {
        match line? {
            Ok(frame) => {
                if !queue.push(frame) {
                    return Ok(false);
                }
            }
            Err(bad) => queue.fault(format!("{from}: {bad}")),
        }
    }
    Ok(true)
}

/// Reads frames, one per line, on a thread of its own; the queue ends with the text.
pub(crate) fn read_lines(reader: impl BufRead + Send + 'static, from: &'static str, queue: &Queue) {
    let queue = queue.clone();
    std::thread::spawn(move || {
        let failed = pass_lines(reader, from, &queue).err();
        queue.end(failed.map(|source| Error::read(from, source)));
    });
}

/// Connects to a program that sends frames, one per line; the queue ends with the connection.
///
/// # Errors
/// Where there is none.
pub(crate) fn connect(address: &str, queue: &Queue) -> Result<()> {
    let stream = TcpStream::connect(address).map_err(broken(address))?;
    let (queue, address) = (queue.clone(), address.to_owned());
    std::thread::spawn(move || {
        let failed = pass_lines(BufReader::new(stream), &address, &queue).err();
        queue.end(failed.map(broken(&address)));
    });
    Ok(())
}

/// Listens for programs that send frames, one per line. The queue ends with the first connection where it is to
/// be the only one; else senders may come and go, also several at once. Returns the address, with its port
/// where 0 was asked for.
///
/// # Errors
/// Where the port is taken.
pub(crate) fn listen(address: SocketAddr, once: bool, queue: &Queue) -> Result<SocketAddr> {
    let listener = TcpListener::bind(address).map_err(broken(address))?;
    let bound = listener.local_addr().map_err(broken(address))?;
    let (queue, senders) = (queue.clone(), Arc::new(AtomicUsize::new(0)));
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(stream) = stream else { continue };
            let from = stream.peer_addr().map_or_else(|_| "a sender".into(), |peer| peer.to_string());
            if once {
                let failed = pass_lines(BufReader::new(stream), &from, &queue).err();
                queue.end(failed.map(broken(&from)));
                return;
            }
            if senders.fetch_add(1, Ordering::Relaxed) >= MAX_SENDERS {
                senders.fetch_sub(1, Ordering::Relaxed);
                queue.fault(format!("{from}: refused, {MAX_SENDERS} others send already"));
                continue;
            }
            let (queue, senders) = (queue.clone(), Arc::clone(&senders));
            std::thread::spawn(move || {
                if let Err(error) = pass_lines(BufReader::new(stream), &from, &queue) {
                    queue.fault(format!("{from}: the connection broke: {error}"));
                }
                senders.fetch_sub(1, Ordering::Relaxed);
            });
        }
    });
    Ok(bound)
}

/// Takes the frames of OpenIGTLink's connections on a thread of its own; the queue ends with the last of them.
pub(crate) fn take_messages(messages: openigtlink::Source, queue: &Queue) {
    let queue = queue.clone();
    std::thread::spawn(move || {
        for frame in messages {
            match frame {
                Ok(frame) => {
                    if !queue.push(frame) {
                        return;
                    }
                }
                Err(error) => queue.fault(error.to_string()),
            }
        }
        queue.end(None);
    });
}
