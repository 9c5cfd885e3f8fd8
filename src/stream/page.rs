//! The server of the page that shows a vessel while it grows (`docs/viewer.md`).
//!
//! Two paths of HTTP/1.1 by hand: a crate would be larger than what is left to do. The thread that reconstructs
//! changes a copy of the vessel and puts each event into the queues of the pages; each page's own thread sends
//! them. A page that reads too slowly loses its queue and gets the whole vessel, so nothing ever waits for a
//! page.

use super::update::{End, Sink, Update};
use crate::reconstruction::Live;
use crate::report::{contour_of, floats, frame_of, live_page, vessel_of_mesh};
use crate::surface::Surface;
use crate::{Error, Result};
use glam::DVec3;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Events that wait for a page, bytes, and how many: beyond, the page gets the whole vessel instead.
const MAX_WAITING_BYTES: usize = 1 << 23;
const MAX_WAITING: usize = 256;
/// Frames whose poses a new page gets, the newest ones.
const MAX_FRAMES: usize = 5_000;
/// Connections at a time.
const MAX_CONNECTIONS: usize = 64;
/// The largest request, bytes, and the longest time that it may take.
const MAX_REQUEST: usize = 1 << 13;
const REQUEST_TIME: Duration = Duration::from_secs(5);
/// A page that takes nothing for so long is gone.
const WRITE_TIME: Duration = Duration::from_secs(10);
/// Between signs of life.
const QUIET_TIME: Duration = Duration::from_secs(15);
/// At the end pages have so much time to take what waits.
const LAST_TIME: Duration = Duration::from_secs(2);

/// The server; dropped, it ends.
pub(crate) struct PageServer {
    shared: Arc<Shared>,
    address: SocketAddr,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    connections: AtomicUsize,
    is_over: AtomicBool,
}

/// What a new page is sent, and what waits for the others.
#[derive(Default)]
struct State {
    vessel: Vessel,
    /// The final mesh, where it replaces the vessel: its event without the frames.
    mesh: Option<Value>,
    /// The last event of all.
    end: Option<Arc<str>>,
    pages: BTreeMap<u64, Waiting>,
    next_page: u64,
}

/// The vessel as pages have it.
#[derive(Default, Clone)]
struct Vessel {
    title: String,
    nodes: usize,
    rings: Vec<Arc<Ring>>,
    /// Without their contours.
    frames: VecDeque<Arc<Value>>,
}

/// A ring: its positions and arrays.
struct Ring {
    positions_mm: Vec<f64>,
    arrays: Vec<(String, Vec<f64>)>,
}

/// Events that wait for a page.
#[derive(Default)]
struct Waiting {
    events: VecDeque<Arc<str>>,
    bytes: usize,
    /// Whether it needs all of the vessel first.
    needs_all: bool,
}

impl Waiting {
    fn add(&mut self, event: &Arc<str>) {
        if self.needs_all {
            return;
        }
        self.bytes += event.len();
        self.events.push_back(Arc::clone(event));
        if self.bytes > MAX_WAITING_BYTES || self.events.len() > MAX_WAITING {
            *self = Self { needs_all: true, ..Self::default() };
        }
    }
}

impl Vessel {
    /// The rings of a part of the vessel.
    fn rings_of(part: &Surface, nodes: usize) -> Vec<Arc<Ring>> {
        let ring = |(k, positions): (usize, &[DVec3])| {
            let within = k * nodes..(k + 1) * nodes;
            Arc::new(Ring {
                positions_mm: positions.iter().flat_map(|p| p.to_array()).collect(),
                arrays: part
                    .arrays
                    .iter()
                    .map(|a| (a.name.clone(), a.values[within.clone()].to_vec()))
                    .collect(),
            })
        };
        match nodes {
            0 => Vec::new(),
            _ => part.nodes_mm.chunks_exact(nodes).enumerate().map(ring).collect(),
        }
    }

    /// The members `positions_mm` and `arrays` of some rings.
    fn content(rings: &[Arc<Ring>]) -> Value {
        let arrays: Map<String, Value> = rings
            .first()
            .map(|first| first.arrays.iter().map(|(name, _)| name))
            .into_iter()
            .flatten()
            .enumerate()
            .map(|(a, name)| {
                (name.clone(), floats(rings.iter().flat_map(|ring| ring.arrays[a].1.iter().copied())))
            })
            .collect();
        let positions = floats(rings.iter().flat_map(|ring| ring.positions_mm.iter().copied()));
        json!({ "positions_mm": positions, "arrays": arrays })
    }

    /// The event with all of it.
    fn event(&self) -> Value {
        let mut event = Self::content(&self.rings);
        event["type"] = "vessel".into();
        event["title"] = self.title.as_str().into();
        event["nodes"] = self.nodes.into();
        event["rings"] = self.rings.len().into();
        event
    }
}

fn text(event: &Value) -> Arc<str> {
    format!("data: {event}\n\n").into()
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn send(&mut self, event: &Arc<str>) {
        self.pages.values_mut().for_each(|page| page.add(event));
    }

    /// Sends all pages the whole vessel next.
    fn begin_anew(&mut self) {
        self.pages.values_mut().for_each(|page| *page = Waiting { needs_all: true, ..Waiting::default() });
    }

    /// What sends all: the vessel or the final mesh, and the end.
    fn all(&self) -> All {
        All { vessel: self.vessel.clone(), mesh: self.mesh.clone(), end: self.end.clone() }
    }
}

struct All {
    vessel: Vessel,
    mesh: Option<Value>,
    end: Option<Arc<str>>,
}

impl All {
    fn text(&self) -> String {
        let mut event = self.mesh.clone().unwrap_or_else(|| self.vessel.event());
        event["frames"] = self.vessel.frames.iter().map(|frame| (**frame).clone()).collect();
        let mut all = text(&event).to_string();
        all.extend(self.end.as_deref());
        all
    }
}

impl PageServer {
    /// Listens on a port of the loopback; 0 takes any that is free.
    ///
    /// # Errors
    /// Where the port is taken.
    pub(crate) fn start(port: u16, title: &str, live: &Live) -> Result<Self> {
        let failed = |source| Error::Output { target: "page", source };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(|e| {
            let hint = format!("port {port} of the loopback: {e} (--view=0 takes any free one)");
            failed(std::io::Error::new(e.kind(), hint))
        })?;
        let address = listener.local_addr().map_err(failed)?;
        let shared = Arc::new(Shared::default());
        let vessel = Vessel {
            title: title.to_owned(),
            nodes: live.nodes(),
            rings: Vessel::rings_of(&live.part(0..live.rings()), live.nodes()),
            frames: VecDeque::new(),
        };
        shared.state().vessel = vessel;
        let of_thread = Arc::clone(&shared);
        std::thread::spawn(move || accept(&listener, &of_thread));
        Ok(Self { shared, address })
    }

    /// Where it listens.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Sink for PageServer {
    fn take(&mut self, update: &Update) -> Result<()> {
        let Update { live, change, frame, number } = update;
        let (nodes, rings) = (live.nodes(), live.rings());
        // Computed before the lock is taken.
        let changed: Vec<(Range<usize>, Vec<Arc<Ring>>)> = change
            .changed
            .iter()
            .map(|range| (range.clone(), Vessel::rings_of(&live.part(range.clone()), nodes)))
            .collect();
        let frame = frame.map(|frame| {
            let sensor_from_probe = live.settings().calibration.sensor_from_probe();
            let mut shown = frame_of(*number, frame.time_s, frame.world_from_sensor * sensor_from_probe);
            if let Some(left_out) = change.left_out.iter().find(|one| one.frame == change.frame) {
                shown["left_out"] = format!("{}: {}", left_out.field, left_out.found).into();
            }
            let plain = Arc::new(shown.clone());
            shown["contour_mm"] = contour_of(frame);
            (plain, shown)
        });
        let mut state = self.shared.state();
        let mut is_new = state.vessel.nodes != nodes || change.restarted;
        let vessel = &mut state.vessel;
        vessel.nodes = nodes;
        if is_new {
            vessel.rings = Vessel::rings_of(&live.part(0..rings), nodes);
        } else {
            let nothing = || Arc::new(Ring { positions_mm: Vec::new(), arrays: Vec::new() });
            vessel.rings.splice(0..0, (0..change.before).map(|_| nothing()));
            vessel.rings.resize_with(rings, nothing);
            for (range, new) in &changed {
                vessel.rings.splice(range.clone(), new.iter().cloned());
            }
        }
        if vessel.rings.iter().any(|ring| ring.positions_mm.is_empty()) {
            // A change that names less than it changed.
            vessel.rings = Vessel::rings_of(&live.part(0..rings), nodes);
            is_new = true;
        }
        if let Some((plain, _)) = &frame {
            vessel.frames.push_back(Arc::clone(plain));
            if vessel.frames.len() > MAX_FRAMES {
                vessel.frames.pop_front();
            }
        }
        if is_new {
            state.begin_anew();
        } else if !state.pages.is_empty() {
            let parts = changed.iter().map(|(range, rings)| {
                let mut part = Vessel::content(rings);
                part["from"] = range.start.into();
                part["to"] = range.end.into();
                part
            });
            let mut event = json!({
                "type": "change", "before": change.before, "rings": rings, "changed": parts.collect::<Vec<_>>(),
            });
            if let Some((_, shown)) = frame {
                event["frame"] = shown;
            }
            state.send(&text(&event));
        }
        drop(state);
        self.shared.changed.notify_all();
        Ok(())
    }

    fn say(&mut self, words: &str) {
        self.shared.state().send(&text(&json!({ "type": "message", "text": words })));
        self.shared.changed.notify_all();
    }

    fn end(&mut self, end: &End) {
        let mut state = self.shared.state();
        if let Some(mesh) = end.mesh.filter(|_| end.is_finished) {
            state.mesh = Some(vessel_of_mesh(&state.vessel.title, mesh));
            state.begin_anew();
        }
        let end = text(&json!({ "type": "end", "text": end.text }));
        state.send(&end);
        state.end = Some(end);
        drop(state);
        self.shared.changed.notify_all();
    }
}

impl Drop for PageServer {
    /// Lets pages take what waits for them, for a while.
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::SeqCst);
        self.shared.changed.notify_all();
        let until = Instant::now() + LAST_TIME;
        while !self.shared.state().pages.is_empty() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
        // Wakes the thread that accepts.
        let _ = TcpStream::connect_timeout(&self.address, Duration::from_millis(200));
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    let Ok(port) = listener.local_addr().map(|address| address.port()) else { return };
    for stream in listener.incoming() {
        if shared.is_over.load(Ordering::SeqCst) {
            return;
        }
        let Ok(mut stream) = stream else {
            // Such as too many open files: others may close some.
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        if shared.connections.fetch_add(1, Ordering::SeqCst) >= MAX_CONNECTIONS {
            shared.connections.fetch_sub(1, Ordering::SeqCst);
            let _ = stream.set_write_timeout(Some(Duration::from_millis(100)));
            let _ = stream.write_all(&answer("503 Service Unavailable", "", b"too many connections\n"));
            continue;
        }
        let shared = Arc::clone(shared);
        std::thread::spawn(move || {
            // A connection that breaks is the page's business: it comes back.
            let _ = serve(&mut stream, port, &shared);
            shared.connections.fetch_sub(1, Ordering::SeqCst);
        });
    }
}

/// An answer with a body, after which the connection ends.
fn answer(status: &str, headers: &str, body: &[u8]) -> Vec<u8> {
    let kind =
        if headers.contains("Content-Type") { "" } else { "Content-Type: text/plain; charset=utf-8\r\n" };
    let head = format!(
        "HTTP/1.1 {status}\r\n{kind}{headers}Content-Length: {}\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

/// What a request asks for, or the answer that refuses it.
#[derive(Debug, PartialEq, Eq)]
enum Asked {
    Page,
    Events,
}

fn asked(request: &[u8], port: u16) -> Result<Asked, Vec<u8>> {
    let refused = |status: &str, headers: &str, why: &str| Err(answer(status, headers, why.as_bytes()));
    let malformed = |why: &str| refused("400 Bad Request", "", why);
    let Ok(request) = std::str::from_utf8(request) else { return malformed("bytes that are no text\n") };
    let mut lines = request.split("\r\n");
    let mut first = lines.next().unwrap_or_default().split(' ');
    let (Some(method), Some(path), Some("HTTP/1.1" | "HTTP/1.0"), None) =
        (first.next(), first.next(), first.next(), first.next())
    else {
        return malformed("no request of HTTP/1.1\n");
    };
    let hosts: Vec<&str> = lines
        .filter_map(|line| line.split_once(':'))
        .filter(|(name, _)| name.eq_ignore_ascii_case("host"))
        .map(|(_, value)| value.trim())
        .collect();
    let [host] = hosts[..] else { return malformed("one Host is expected\n") };
    // A page from elsewhere could otherwise read the vessel through a name that it resolves to the loopback.
    let is_own = |name: &&str| host.eq_ignore_ascii_case(&format!("{name}:{port}"));
    if !["localhost", "127.0.0.1", "[::1]"].iter().any(is_own) {
        return refused("403 Forbidden", "", "the Host is not this server's\n");
    }
    match (method, path) {
        ("GET", "/") => Ok(Asked::Page),
        ("GET", "/events") => Ok(Asked::Events),
        ("GET", _) => refused("404 Not Found", "", "there are / and /events\n"),
        _ => refused("405 Method Not Allowed", "Allow: GET\r\n", "only GET\n"),
    }
}

fn serve(stream: &mut TcpStream, port: u16, shared: &Shared) -> std::io::Result<()> {
    stream.set_write_timeout(Some(WRITE_TIME))?;
    stream.set_nodelay(true)?;
    let request = read_request(stream)?;
    match asked(&request, port) {
        Ok(Asked::Events) => {
            stream.write_all(
                b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\n\
                  X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\nretry: 1000\n\n",
            )?;
            let page = {
                let mut state = shared.state();
                let page = state.next_page;
                state.next_page += 1;
                state.pages.insert(page, Waiting { needs_all: true, ..Waiting::default() });
                page
            };
            let sent = send_events(stream, shared, page);
            shared.state().pages.remove(&page);
            return sent;
        }
        Ok(Asked::Page) => {
            let headers = "Content-Type: text/html; charset=utf-8\r\nContent-Security-Policy: frame-ancestors 'none'\r\n";
            stream.write_all(&answer("200 OK", headers, live_page().as_bytes()))?;
        }
        Err(refusal) => stream.write_all(&refusal)?,
    }
    // A body that nobody reads would reset the connection before the answer is read.
    stream.shutdown(Shutdown::Write)?;
    stream.set_read_timeout(Some(Duration::from_millis(200)))?;
    std::io::copy(&mut (&*stream).take(1 << 16), &mut std::io::sink())?;
    Ok(())
}

/// The head of a request.
fn read_request(stream: &mut TcpStream) -> std::io::Result<Vec<u8>> {
    let until = Instant::now() + REQUEST_TIME;
    let mut request = Vec::new();
    let mut buffer = [0; 1024];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() || request.len() > MAX_REQUEST {
            return Err(std::io::ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut buffer)? {
            0 => return Err(std::io::ErrorKind::UnexpectedEof.into()),
            n => request.extend(&buffer[..n]),
        }
        if let Some(end) = request.windows(4).position(|four| four == b"\r\n\r\n") {
            request.truncate(end);
            return Ok(request);
        }
    }
}

/// Sends a page its events until the end, or until the connection is gone.
fn send_events(stream: &mut TcpStream, shared: &Shared, page: u64) -> std::io::Result<()> {
    enum Work {
        All(All),
        Events(VecDeque<Arc<str>>),
        Quiet,
    }
    loop {
        let is_over = || shared.is_over.load(Ordering::SeqCst);
        let (work, is_ended) = {
            let nothing = |state: &mut State| {
                let waiting = state.pages.get(&page);
                waiting.is_some_and(|w| !w.needs_all && w.events.is_empty())
                    && state.end.is_none()
                    && !is_over()
            };
            let (mut state, _) = shared
                .changed
                .wait_timeout_while(shared.state(), QUIET_TIME, nothing)
                .unwrap_or_else(PoisonError::into_inner);
            let needs_all = state.pages.get(&page).is_some_and(|waiting| waiting.needs_all);
            let work = match needs_all {
                true => {
                    state.pages.insert(page, Waiting::default());
                    Work::All(state.all())
                }
                false => match state.pages.get_mut(&page) {
                    Some(waiting) if !waiting.events.is_empty() => {
                        Work::Events(std::mem::take(waiting).events)
                    }
                    _ => Work::Quiet,
                },
            };
            (work, state.end.is_some() || is_over())
        };
        match work {
            Work::All(all) => stream.write_all(all.text().as_bytes())?,
            Work::Events(events) => events.iter().try_for_each(|event| stream.write_all(event.as_bytes()))?,
            Work::Quiet if is_ended => return Ok(()),
            Work::Quiet => stream.write_all(b":\n\n")?,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(request: &str) -> String {
        match asked(request.replace('\n', "\r\n").as_bytes(), 8000) {
            Ok(asked) => format!("{asked:?}"),
            Err(answer) => String::from_utf8(answer).unwrap()["HTTP/1.1 ".len()..][..3].to_owned(),
        }
    }

    #[test]
    fn only_this_servers_own_names_are_answered() {
        for host in ["localhost:8000", "127.0.0.1:8000", "[::1]:8000", "LocalHost:8000"] {
            assert_eq!(status(&format!("GET / HTTP/1.1\nHost: {host}")), "Page");
            assert_eq!(status(&format!("GET /events HTTP/1.1\nAccept: */*\nhost:{host} ")), "Events");
        }
        for host in
            ["evil.example", "evil.example:8000", "localhost", "localhost:80", "127.0.0.1:8000.evil.example"]
        {
            assert_eq!(status(&format!("GET / HTTP/1.1\nHost: {host}")), "403", "{host}");
        }
        assert_eq!(status("GET / HTTP/1.1"), "400");
        assert_eq!(status("GET / HTTP/1.1\nHost: localhost:8000\nHost: evil.example"), "400");
    }

    #[test]
    fn other_paths_and_methods_are_refused() {
        let with_host = |line: &str| status(&format!("{line}\nHost: localhost:8000"));
        assert_eq!(with_host("GET /index.html HTTP/1.1"), "404");
        assert_eq!(with_host("GET /../etc/passwd HTTP/1.1"), "404");
        assert_eq!(with_host("GET /events?x HTTP/1.1"), "404");
        for method in ["POST", "HEAD", "PUT", "OPTIONS", "get"] {
            assert_eq!(with_host(&format!("{method} / HTTP/1.1")), "405", "{method}");
        }
        for line in ["", "GET", "GET /", "GET / HTTP/2", "GET  / HTTP/1.1", "GET / / HTTP/1.1", "\u{0}"] {
            assert_eq!(with_host(line), "400", "{line:?}");
        }
    }

    #[test]
    fn a_page_that_reads_too_slowly_loses_its_queue_for_all_of_the_vessel() {
        let event = |bytes: usize| -> Arc<str> { "x".repeat(bytes).into() };
        let mut few = Waiting::default();
        (0..MAX_WAITING).for_each(|_| few.add(&event(1)));
        assert!(!few.needs_all && few.events.len() == MAX_WAITING);
        few.add(&event(1));
        assert!(few.needs_all && few.events.is_empty() && few.bytes == 0);
        few.add(&event(1));
        assert!(few.events.is_empty(), "what comes before the vessel is not sent");
        let mut large = Waiting::default();
        large.add(&event(MAX_WAITING_BYTES + 1));
        assert!(large.needs_all && large.events.is_empty());
    }
}
