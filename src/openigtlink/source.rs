//! Frames out of connections.

use super::assembler::{AssemblerOptions, FrameAssembler, FrameCounts};
use super::client::{Client, ClientOptions};
use super::queue::{Incoming, Queue, Traffic, lock};
use super::server::{Server, ServerOptions};
use crate::recording::Frame;
use crate::{Error, Result};
use serde::Serialize;
use std::collections::VecDeque;
use std::fmt;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// How frames come out of connections.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SourceOptions {
    /// How frames are made of messages.
    pub assembler: AssemblerOptions,
    /// How long a lost connection to a server is tried to be made again, s. Then it has ended.
    pub give_up_s: f64,
    /// Whether to ask servers for `TDATA`, and for how often at most, ms; 0: as often as there are any.
    pub tracking_interval_ms: Option<u32>,
    /// Whether a connection that others make ends the source when the last of them is gone.
    pub until_disconnected: bool,
}

impl Default for SourceOptions {
    fn default() -> Self {
        Self {
            assembler: AssemblerOptions::default(),
            give_up_s: 10.0,
            tracking_interval_ms: None,
            until_disconnected: false,
        }
    }
}

crate::setters::setters!(SourceOptions {
    with_assembler => assembler: AssemblerOptions,
    with_give_up_s => give_up_s: f64,
    with_tracking_interval_ms => tracking_interval_ms: Option<u32>,
    with_until_disconnected => until_disconnected: bool,
});

/// What came in, and what became of it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct Counts {
    /// What connections brought.
    #[serde(flatten)]
    pub traffic: Traffic,
    /// What became of the messages.
    #[serde(flatten)]
    pub frames: FrameCounts,
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Traffic { connections, connections_ended, messages, unknown, refused } = &self.traffic;
        write!(
            f,
            "{messages} messages of {connections} connections ({connections_ended} ended), {unknown} of unknown kinds, \
             {refused} refused: {}",
            self.frames
        )
    }
}

/// The counts of a [`Source`] that runs.
#[derive(Debug, Clone)]
pub struct SharedCounts {
    queue: Queue,
    frames: Arc<Mutex<FrameCounts>>,
}

impl SharedCounts {
    /// The counts so far.
    pub fn now(&self) -> Counts {
        Counts { traffic: self.queue.traffic(), frames: lock(&self.frames).clone() }
    }
}

/// Ends a [`Source`] from outside.
#[derive(Debug, Clone)]
pub struct Stopper(Queue);

impl Stopper {
    /// Ends the source: [`next`](Iterator::next) gives what it has made already, then `None`.
    pub fn stop(&self) {
        self.0.stop();
    }
}

/// Frames out of any number of connections, as the [`FrameAssembler`] makes them. As an iterator it waits for
/// the next frame; an error is about something that was left out, or a connection that was lost, and the next
/// frame may follow. It ends when all connections have ended, or when it is [stopped](Stopper).
///
/// ```no_run
/// use lumenmesh::openigtlink::{Source, SourceOptions};
///
/// let mut source = Source::new(&SourceOptions::default())?;
/// source.connect("127.0.0.1:18944")?;
/// for frame in source {
///     match frame {
///         Ok(frame) => println!("{:?}: {} points", frame.time_s, frame.contour_mm.len()),
///         Err(error) => eprintln!("{error}"),
///     }
/// }
/// # Ok::<(), lumenmesh::Error>(())
/// ```
#[derive(Debug)]
pub struct Source {
    options: SourceOptions,
    queue: Queue,
    assembler: FrameAssembler,
    counts: Arc<Mutex<FrameCounts>>,
    ready: VecDeque<Frame>,
    clients: Vec<Client>,
    servers: Vec<Arc<Server>>,
}

impl Source {
    /// A source without connections.
    ///
    /// # Errors
    /// [`Error::Setting`] where an option makes no sense.
    pub fn new(options: &SourceOptions) -> Result<Self> {
        if !(0.0..=1e6).contains(&options.give_up_s) {
            return Err(Error::setting(
                "time until a connection is given up",
                options.give_up_s,
                "0 to 1e6 s",
            ));
        }
        Ok(Self {
            assembler: FrameAssembler::new(options.assembler.clone())?,
            options: options.clone(),
            queue: Queue::default(),
            counts: Arc::default(),
            ready: VecDeque::new(),
            clients: Vec::new(),
            servers: Vec::new(),
        })
    }

    /// Takes messages of a server, such as PLUS on port 18944, and returns its address. A connection that is
    /// lost is made again: after 0.1 s, then after twice as long each time up to 2 s, until
    /// [`give_up_s`](SourceOptions::give_up_s) have passed since it was lost.
    ///
    /// # Errors
    /// [`Error::Connection`] where there is no server at that address: it has to be there first.
    pub fn connect(&mut self, address: &str) -> Result<SocketAddr> {
        let options = ClientOptions {
            give_up: Duration::from_secs_f64(self.options.give_up_s),
            tracking_ms: self.options.tracking_interval_ms,
        };
        let client = Client::connect(address, options, self.queue.sender())?;
        let address = client.address();
        self.clients.push(client);
        Ok(address)
    }

    /// Takes messages of all that connect to this address. The vessel can be sent back to them.
    ///
    /// # Errors
    /// As [`Server::start`].
    pub fn listen(&mut self, address: &str) -> Result<Arc<Server>> {
        let inbox = self.queue.sender();
        let options = ServerOptions::default();
        let server = Server::with_inbox(address, &options, Some(inbox), self.options.until_disconnected)?;
        let server = Arc::new(server);
        self.servers.push(Arc::clone(&server));
        Ok(server)
    }

    /// Ends the source from outside.
    pub fn stopper(&self) -> Stopper {
        Stopper(self.queue.clone())
    }

    /// The counts, also while the source runs elsewhere.
    pub fn counts(&self) -> SharedCounts {
        SharedCounts { queue: self.queue.clone(), frames: Arc::clone(&self.counts) }
    }

    fn publish_counts(&self) {
        lock(&self.counts).clone_from(self.assembler.counts());
    }
}

impl Iterator for Source {
    type Item = Result<Frame>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(frame) = self.ready.pop_front() {
                return Some(Ok(frame));
            }
            match self.queue.next() {
                Some(Incoming::Message(message)) => {
                    let pushed = self.assembler.push(&message);
                    self.publish_counts();
                    match pushed {
                        Ok(frames) => self.ready.extend(frames),
                        Err(error) => return Some(Err(error)),
                    }
                }
                Some(Incoming::Fault(error)) => return Some(Err(error)),
                None => {
                    self.ready.extend(self.assembler.flush());
                    self.publish_counts();
                    return self.ready.pop_front().map(Ok);
                }
            }
        }
    }
}

impl Drop for Source {
    /// Ends all connections and joins their threads; servers that others hold go on, without giving messages
    /// to anyone.
    fn drop(&mut self) {
        self.queue.stop();
    }
}
