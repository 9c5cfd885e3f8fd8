//! The vessel for whoever connects, such as 3D Slicer.

use super::client::addresses_of;
use super::content::{Content, Status};
use super::message::Message;
use super::poly_data::PolyData;
use super::queue::{Sender, lock};
use super::stream::{MessageReader, Step};
use super::time::Timestamp;
use crate::geometry::Pose;
use crate::surface::Surface;
use crate::{Error, Result};
use std::collections::VecDeque;
use std::io::{self, BufReader, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Clients at a server; more are turned away.
pub const MAX_CLIENTS: usize = 16;
/// Texts that wait for a client; of more the oldest are left out.
const MAX_TEXTS: usize = 64;
/// How often the server looks for new clients, and for such that are gone.
const LOOK: Duration = Duration::from_millis(20);
/// A client that takes nothing for so long is let go.
const STUCK: Duration = Duration::from_secs(30);
/// How long a server that ends goes on sending what waits.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// How a server goes about it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ServerOptions {
    /// Name of the vessel: the model in Slicer.
    pub vessel_device: String,
    /// Name of the catheter's tip: the transform in Slicer.
    pub tip_device: String,
    /// Name of status and texts.
    pub device: String,
    /// Shortest time between two vessels that [`Server::wants_vessel`] asks for, s. Slicer replaces the whole
    /// model each time.
    pub vessel_interval_s: f64,
}

impl Default for ServerOptions {
    fn default() -> Self {
        Self {
            vessel_device: "Lumen".into(),
            tip_device: "CatheterTip".into(),
            device: "lumenmesh".into(),
            vessel_interval_s: 0.25,
        }
    }
}

crate::setters::setters!(ServerOptions {
    with_vessel_device => vessel_device: String,
    with_tip_device => tip_device: String,
    with_device => device: String,
    with_vessel_interval_s => vessel_interval_s: f64,
});

/// Sends a vessel that grows, the catheter's tip, its status and texts to all who are connected.
///
/// Nothing here waits for a client: for each there waits the newest vessel, the newest tip and a few texts,
/// and what was not sent yet gives way to what is newer. A vessel that is being sent is sent whole. Who
/// connects later gets the newest vessel at once. Messages have the version of header that a client has sent
/// itself, 1 until it has sent 2, as with PLUS.
///
/// Dropping it sends what waits, for at most a second, and ends its threads.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    accepting: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    options: ServerOptions,
    ending: AtomicBool,
    peers: Mutex<Vec<Peer>>,
    newest: Mutex<Newest>,
}

/// What a client that connects gets at once.
#[derive(Debug, Default)]
struct Newest {
    vessel: Option<Arc<Vessel>>,
    status: Status,
    /// When the last vessel was taken.
    sent: Option<Instant>,
}

/// A vessel on its way. It becomes bytes on the thread of the first client that takes it, once for each
/// version of header.
#[derive(Debug)]
struct Vessel {
    surface: Surface,
    time: Timestamp,
    bytes: [OnceLock<Vec<u8>>; 2],
}

impl Vessel {
    fn bytes(&self, version: u16, options: &ServerOptions) -> &[u8] {
        let place = usize::from(version > 1);
        self.bytes[place].get_or_init(|| {
            let content = Content::PolyData(PolyData::of_surface(&self.surface));
            encoded(&Message::new(&options.vessel_device, self.time, content).with_version(version))
        })
    }
}

/// A message that is known to fit its fields; empty where it does not.
fn encoded(message: &Message) -> Vec<u8> {
    message.encode().unwrap_or_default()
}

/// A client.
#[derive(Debug)]
struct Peer {
    stream: TcpStream,
    outbox: Arc<Outbox>,
    threads: [JoinHandle<()>; 2],
}

impl Peer {
    fn is_done(&self) -> bool {
        self.threads.iter().all(JoinHandle::is_finished)
    }

    fn end(self) {
        self.outbox.close();
        let _ = self.stream.shutdown(Shutdown::Both);
        for thread in self.threads {
            let _ = thread.join();
        }
    }
}

/// What waits for a client.
#[derive(Debug, Default)]
struct Outbox {
    waiting: Mutex<Waiting>,
    changed: Condvar,
    /// The highest version of header that the client has sent.
    version: AtomicU16,
}

#[derive(Debug, Default)]
struct Waiting {
    vessel: Option<Arc<Vessel>>,
    tip: Option<Arc<Message>>,
    texts: VecDeque<Arc<Message>>,
    /// Whether something is being sent.
    busy: bool,
    closed: bool,
}

impl Waiting {
    fn is_empty(&self) -> bool {
        self.vessel.is_none() && self.tip.is_none() && self.texts.is_empty()
    }
}

/// What is sent next.
enum Next {
    Message(Arc<Message>),
    Vessel(Arc<Vessel>),
}

impl Outbox {
    fn put(&self, put: impl FnOnce(&mut Waiting)) {
        put(&mut lock(&self.waiting));
        self.changed.notify_all();
    }

    fn put_text(&self, message: Arc<Message>) {
        self.put(|waiting| {
            if waiting.texts.len() >= MAX_TEXTS {
                waiting.texts.pop_front();
            }
            waiting.texts.push_back(message);
        });
    }

    fn close(&self) {
        self.put(|waiting| waiting.closed = true);
    }

    /// What is to be sent next; waits for it. `None`: closed.
    fn next(&self) -> Option<Next> {
        let mut waiting = lock(&self.waiting);
        waiting.busy = false;
        self.changed.notify_all();
        loop {
            if waiting.closed {
                return None;
            }
            let text = waiting.texts.pop_front().or_else(|| waiting.tip.take()).map(Next::Message);
            if let Some(next) = text.or_else(|| waiting.vessel.take().map(Next::Vessel)) {
                waiting.busy = true;
                return Some(next);
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Waits until all is sent, or until then.
    fn wait_until_sent(&self, end: Instant) {
        let mut waiting = lock(&self.waiting);
        while (waiting.busy || !waiting.is_empty()) && !waiting.closed {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            let waited = self.changed.wait_timeout(waiting, left);
            waiting = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn version(&self) -> u16 {
        self.version.load(Ordering::Relaxed).max(1)
    }
}

impl Server {
    /// Waits for clients at `host:port`, `host` or `port`, by default at 127.0.0.1 and port 18944; port 0:
    /// any that is free.
    ///
    /// # Errors
    /// [`Error::Connection`] where the address cannot be used, such as that of another server.
    pub fn start(address: &str) -> Result<Self> {
        Self::with_options(address, &ServerOptions::default())
    }

    /// As [`start`](Self::start).
    ///
    /// # Errors
    /// As [`start`](Self::start), and [`Error::Setting`] where an option makes no sense.
    pub fn with_options(address: &str, options: &ServerOptions) -> Result<Self> {
        Self::with_inbox(address, options, None, false)
    }

    /// As [`with_options`](Self::with_options); what clients send goes to `inbox`, until the last client is
    /// gone where that should end it.
    pub(super) fn with_inbox(
        address: &str,
        options: &ServerOptions,
        inbox: Option<Sender>,
        until_disconnected: bool,
    ) -> Result<Self> {
        if !(0.0..=3600.0).contains(&options.vessel_interval_s) {
            return Err(Error::setting("interval of vessels", options.vessel_interval_s, "0 to 3600 s"));
        }
        let failed = |source| Error::Connection { address: address.to_owned(), source };
        let listener = TcpListener::bind(&addresses_of(address)?[..]).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let shared = Arc::new(Shared {
            options: options.clone(),
            ending: AtomicBool::new(false),
            peers: Mutex::default(),
            newest: Mutex::new(Newest { status: Status::ok("ready"), ..Newest::default() }),
        });
        let accepting = thread::Builder::new()
            .name("openigtlink server".into())
            .spawn({
                let shared = Arc::clone(&shared);
                move || shared.accept(&listener, inbox, until_disconnected)
            })
            .map_err(failed)?;
        Ok(Self { address: bound, shared, accepting: Some(accepting) })
    }

    /// Where it waits, with its real port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Clients that are connected.
    pub fn clients(&self) -> usize {
        lock(&self.shared.peers).iter().filter(|peer| !peer.is_done()).count()
    }

    /// Whether a client is there that has all that was sent, and the
    /// [interval](ServerOptions::vessel_interval_s) since the last vessel is over: only then is it worth
    /// making a surface.
    pub fn wants_vessel(&self) -> bool {
        let interval = Duration::from_secs_f64(self.shared.options.vessel_interval_s);
        if lock(&self.shared.newest).sent.is_some_and(|sent| sent.elapsed() < interval) {
            return false;
        }
        let has_all = |peer: &Peer| {
            let waiting = lock(&peer.outbox.waiting);
            !waiting.closed && waiting.vessel.is_none() && !waiting.busy
        };
        lock(&self.shared.peers).iter().any(has_all)
    }

    /// Sends a vessel to all; one that waits is replaced. A surface without triangles is not sent: Slicer
    /// cannot take it.
    pub fn send_vessel(&self, surface: &Surface) {
        if surface.triangles.is_empty() {
            return;
        }
        let vessel = Arc::new(Vessel {
            surface: surface.clone(),
            time: Timestamp::now(),
            bytes: [OnceLock::new(), OnceLock::new()],
        });
        {
            let mut newest = lock(&self.shared.newest);
            newest.vessel = Some(Arc::clone(&vessel));
            newest.sent = Some(Instant::now());
        }
        self.to_all(|outbox| outbox.put(|waiting| waiting.vessel = Some(Arc::clone(&vessel))));
    }

    /// Sends where the catheter's tip is, in the tracker's coordinates, to all, with the time of the frame in
    /// the metadata `FrameTime`, s. A [lost](Pose::LOST) pose is sent with the metadata `TransformStatus`
    /// `INVALID`, and not to clients of header 1, which could not tell.
    pub fn send_tip(&self, world_from_tip: Pose, time_s: Option<f64>) {
        let is_ok = world_from_tip.is_finite();
        let pose = if is_ok { world_from_tip } else { Pose::IDENTITY };
        let (rotation, translation) = (pose.rotation.as_mat3(), pose.translation_mm.as_vec3());
        let row = |k: usize| [rotation.x_axis[k], rotation.y_axis[k], rotation.z_axis[k], translation[k]];
        let content = Content::Transform([row(0), row(1), row(2)]);
        let mut message = Message::new(&self.shared.options.tip_device, Timestamp::now(), content)
            .with_metadata("TransformStatus", if is_ok { "OK" } else { "INVALID" });
        if let Some(time_s) = time_s {
            message = message.with_metadata("FrameTime", time_s.to_string());
        }
        let message = Arc::new(message);
        self.to_all(|outbox| {
            if is_ok || outbox.version() > 1 {
                outbox.put(|waiting| waiting.tip = Some(Arc::clone(&message)));
            }
        });
    }

    /// Sends a status in words to all: that it works. It is also the answer to `GET_STATUS` from now on.
    pub fn send_status(&self, words: &str) {
        let status = Status::ok(words);
        lock(&self.shared.newest).status = status.clone();
        self.send_to_all(Content::Status(status));
    }

    /// Sends a text to all, such as a report in JSON.
    ///
    /// # Errors
    /// [`Error::Recording`] where it is longer than the 65535 bytes that a `STRING` holds.
    pub fn send_text(&self, text: &str) -> Result<()> {
        let content = Content::Text(text.into());
        Message::new("", Timestamp::UNKNOWN, content.clone()).encode()?;
        self.send_to_all(content);
        Ok(())
    }

    fn send_to_all(&self, content: Content) {
        let message = Arc::new(Message::new(&self.shared.options.device, Timestamp::now(), content));
        self.to_all(|outbox| outbox.put_text(Arc::clone(&message)));
    }

    fn to_all(&self, send: impl Fn(&Outbox)) {
        lock(&self.shared.peers).iter().for_each(|peer| send(&peer.outbox));
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.ending.store(true, Ordering::Relaxed);
        if let Some(accepting) = self.accepting.take() {
            let _ = accepting.join();
        }
    }
}

impl Shared {
    fn accept(self: Arc<Self>, listener: &TcpListener, inbox: Option<Sender>, until_disconnected: bool) {
        let mut inbox = inbox;
        while !self.ending.load(Ordering::Relaxed) {
            match listener.accept() {
                Ok((stream, _)) => {
                    if lock(&self.peers).len() < MAX_CLIENTS {
                        // A client that is gone already is none.
                        let _ = self.welcome(stream, inbox.as_ref());
                    }
                    continue;
                }
                Err(_) => thread::sleep(LOOK),
            }
            let mut peers = lock(&self.peers);
            let gone: Vec<Peer> = peers.extract_if(.., |peer| peer.is_done()).collect();
            if until_disconnected && peers.is_empty() && !gone.is_empty() {
                inbox = None;
            }
            drop(peers);
            gone.into_iter().for_each(Peer::end);
        }
        drop(inbox);
        let peers = std::mem::take(&mut *lock(&self.peers));
        let end = Instant::now() + LAST_WORDS;
        for peer in &peers {
            peer.outbox.wait_until_sent(end);
            peer.outbox.close();
            // The client reads what is on its way, and then that this was all.
            let _ = peer.stream.shutdown(Shutdown::Write);
        }
        while Instant::now() < end && !peers.iter().all(Peer::is_done) {
            thread::sleep(Duration::from_millis(2));
        }
        peers.into_iter().for_each(Peer::end);
    }

    fn welcome(self: &Arc<Self>, stream: TcpStream, inbox: Option<&Sender>) -> io::Result<()> {
        // Some systems hand on what the listener has.
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(STUCK))?;
        let outbox = Arc::new(Outbox::default());
        let (reading, writing) = (stream.try_clone()?, stream.try_clone()?);
        let mut peers = lock(&self.peers);
        lock(&outbox.waiting).vessel = lock(&self.newest).vessel.clone();
        let reader = thread::Builder::new().name("openigtlink reader".into()).spawn({
            let (shared, outbox, inbox) = (Arc::clone(self), Arc::clone(&outbox), inbox.cloned());
            move || {
                shared.read(&reading, &outbox, inbox.as_ref());
                outbox.close();
            }
        })?;
        let writer = thread::Builder::new().name("openigtlink writer".into()).spawn({
            let (shared, outbox) = (Arc::clone(self), Arc::clone(&outbox));
            move || {
                if shared.write(&writing, &outbox).is_err() {
                    let _ = writing.shutdown(Shutdown::Both);
                }
                outbox.close();
            }
        });
        match writer {
            Ok(writer) => peers.push(Peer { stream, outbox, threads: [reader, writer] }),
            Err(error) => {
                let _ = stream.shutdown(Shutdown::Both);
                let _ = reader.join();
                return Err(error);
            }
        }
        Ok(())
    }

    /// Reads until the client is gone.
    fn read(&self, stream: &TcpStream, outbox: &Outbox, inbox: Option<&Sender>) {
        let count = |change: fn(&mut super::queue::Traffic)| {
            if let Some(inbox) = inbox {
                inbox.count(change);
            }
        };
        count(|traffic| traffic.connections += 1);
        let mut reader = MessageReader::new(BufReader::with_capacity(1 << 16, stream));
        loop {
            let step = reader.step();
            if let Some(version) = reader.version() {
                outbox.version.fetch_max(version, Ordering::Relaxed);
            }
            let goes_on = !matches!(step, Step::Closed(_) | Step::Lost(_));
            if let Step::Message(Message { content: Content::GetStatus, .. }) = &step {
                let status = Content::Status(lock(&self.newest).status.clone());
                let message = Message::new(&self.options.device, Timestamp::now(), status);
                outbox.put_text(Arc::new(message));
            }
            if let Some(inbox) = inbox {
                // Where nobody takes it any more, the client may still look.
                let _ = inbox.take(step);
            }
            if !goes_on {
                break;
            }
        }
        count(|traffic| traffic.connections_ended += 1);
    }

    fn write(&self, mut stream: &TcpStream, outbox: &Outbox) -> io::Result<()> {
        while let Some(next) = outbox.next() {
            let version = outbox.version();
            match next {
                Next::Message(message) => {
                    let message = Message::clone(&message).with_version(version);
                    stream.write_all(&encoded(&message))?;
                }
                Next::Vessel(vessel) => stream.write_all(vessel.bytes(version, &self.options))?,
            }
        }
        Ok(())
    }
}
