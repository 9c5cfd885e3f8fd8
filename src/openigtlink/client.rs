//! A connection to a server, such as PLUS, that is made again when it is lost.

use super::content::Content;
use super::message::Message;
use super::queue::{Incoming, Sender, lock};
use super::stream::{MessageReader, Step};
use super::time::Timestamp;
use crate::{Error, Result};
use std::io::{self, ErrorKind, Write};
use std::net::{Shutdown, SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The port of PLUS and Slicer.
const USUAL_PORT: u16 = 18944;
/// How long a connection may take to be made.
const CONNECT: Duration = Duration::from_secs(3);
/// After so long without a byte the server is asked for its status.
const ASK_AFTER: Duration = Duration::from_secs(2);
/// After so long without a byte the connection is taken for lost.
const LOST_AFTER: Duration = Duration::from_secs(30);
/// The first wait before a lost connection is made again; each next one is twice as long, up to the last.
const FIRST_WAIT: Duration = Duration::from_millis(100);
const LAST_WAIT: Duration = Duration::from_secs(2);

/// The addresses that a text names: `host:port`, `host`, `port` or `:port`. Without a host it is this machine
/// (127.0.0.1), without a port 18944.
pub(super) fn addresses_of(text: &str) -> Result<Vec<SocketAddr>> {
    let failed = |source| Error::Connection { address: text.to_owned(), source };
    let text = text.trim();
    let port = text.strip_prefix(':').unwrap_or(text).parse::<u16>();
    let found = match port {
        Ok(port) => ("127.0.0.1", port).to_socket_addrs(),
        Err(_) => match text.to_socket_addrs() {
            Err(_) if !text.contains(':') => (text, USUAL_PORT).to_socket_addrs(),
            found => found,
        },
    };
    let mut found: Vec<SocketAddr> = found.map_err(failed)?.collect();
    if found.is_empty() {
        return Err(failed(io::Error::new(ErrorKind::NotFound, "no such host")));
    }
    // Most servers listen on IPv4 only.
    found.sort_by_key(SocketAddr::is_ipv6);
    Ok(found)
}

/// A connection that reads on a thread of its own, until its queue is stopped or the server is lost for good.
#[derive(Debug)]
pub(super) struct Client {
    address: SocketAddr,
    /// The connection that is read now, to end it.
    stream: Arc<Mutex<Option<TcpStream>>>,
    thread: Option<JoinHandle<()>>,
}

/// How a client goes about it.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClientOptions {
    /// How long a lost connection is tried to be made again.
    pub give_up: Duration,
    /// Whether to ask for `TDATA`, and for how often, ms.
    pub tracking_ms: Option<u32>,
}

impl Client {
    /// Connects.
    ///
    /// # Errors
    /// [`Error::Connection`] where that fails: the server has to be there first.
    pub fn connect(address: &str, options: ClientOptions, inbox: Sender) -> Result<Self> {
        let addresses = addresses_of(address)?;
        let first = connected(&addresses, &options)
            .map_err(|source| Error::Connection { address: address.to_owned(), source })?;
        let peer = first.peer_addr().ok().unwrap_or(addresses[0]);
        let stream = Arc::new(Mutex::new(first.try_clone().ok()));
        inbox.count(|traffic| traffic.connections += 1);
        let run = Run { address: peer, options, inbox, stream: Arc::clone(&stream) };
        let thread = std::thread::Builder::new()
            .name("openigtlink client".into())
            .spawn(move || run.run(first))
            .map_err(|source| Error::Connection { address: address.to_owned(), source })?;
        Ok(Self { address: peer, stream, thread: Some(thread) })
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Client {
    /// Ends the connection. The queue has to be stopped before.
    fn drop(&mut self) {
        if let Some(stream) = &*lock(&self.stream) {
            let _ = stream.shutdown(Shutdown::Both);
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A connection, which has been asked for what it should send.
fn connected(addresses: &[SocketAddr], options: &ClientOptions) -> io::Result<TcpStream> {
    let mut failed = io::Error::from(ErrorKind::NotFound);
    for address in addresses {
        match TcpStream::connect_timeout(address, CONNECT) {
            Ok(mut stream) => {
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(ASK_AFTER))?;
                stream.set_write_timeout(Some(CONNECT))?;
                ask(&mut stream, Content::GetStatus)?;
                if let Some(interval_ms) = options.tracking_ms {
                    ask(&mut stream, Content::StartTracking(interval_ms))?;
                }
                return Ok(stream);
            }
            Err(error) => failed = error,
        }
    }
    Err(failed)
}

/// Sends a request with header 2: PLUS answers with the highest version that it has seen, and only header 2
/// says whether a transform is valid.
fn ask(stream: &mut TcpStream, content: Content) -> io::Result<()> {
    let message = Message::new("lumenmesh", Timestamp::now(), content).with_version(2);
    let bytes = message.encode().map_err(io::Error::other)?;
    stream.write_all(&bytes)
}

struct Run {
    address: SocketAddr,
    options: ClientOptions,
    inbox: Sender,
    stream: Arc<Mutex<Option<TcpStream>>>,
}

impl Run {
    fn run(self, first: TcpStream) {
        let mut stream = first;
        loop {
            let why = self.read(&stream);
            let _ = stream.shutdown(Shutdown::Both);
            *lock(&self.stream) = None;
            self.inbox.count(|traffic| traffic.connections_ended += 1);
            if self.inbox.is_stopped() {
                return;
            }
            let fault = Error::Connection { address: self.address.to_string(), source: why };
            if !self.inbox.send(Incoming::Fault(fault)) {
                return;
            }
            match self.again() {
                Some(next) => stream = next,
                None => return,
            }
        }
    }

    /// Reads until the connection is lost, and says why.
    fn read(&self, stream: &TcpStream) -> io::Error {
        let mut asking = match stream.try_clone() {
            Ok(stream) => stream,
            Err(error) => return error,
        };
        let mut reader = MessageReader::new(io::BufReader::with_capacity(1 << 16, stream));
        let mut heard = Instant::now();
        loop {
            let step = reader.step();
            if self.inbox.is_stopped() {
                return io::Error::from(ErrorKind::Interrupted);
            }
            match step {
                Step::Silent if heard.elapsed() > LOST_AFTER => {
                    return io::Error::new(
                        ErrorKind::TimedOut,
                        format!("nothing came for {} s", LOST_AFTER.as_secs()),
                    );
                }
                Step::Silent => {
                    if let Err(error) = ask(&mut asking, Content::GetStatus) {
                        return error;
                    }
                    continue;
                }
                Step::Closed(Ok(())) => {
                    return io::Error::new(ErrorKind::UnexpectedEof, "the server closed the connection");
                }
                Step::Closed(Err(error)) => return error,
                Step::Lost(error) => return io::Error::new(ErrorKind::InvalidData, error.to_string()),
                step => {
                    if !self.inbox.take(step) {
                        return io::Error::from(ErrorKind::Interrupted);
                    }
                }
            }
            heard = Instant::now();
        }
    }

    /// Makes a lost connection again; `None` where that has failed for too long, or the queue was stopped.
    fn again(&self) -> Option<TcpStream> {
        let lost = Instant::now();
        let mut wait = FIRST_WAIT;
        while lost.elapsed() < self.options.give_up {
            self.inbox.wait(wait.min(self.options.give_up));
            if self.inbox.is_stopped() {
                return None;
            }
            if let Ok(stream) = connected(&[self.address], &self.options) {
                let mut place = lock(&self.stream);
                *place = stream.try_clone().ok();
                drop(place);
                // Who stops the queue first and ends the connection then, sees one of the two.
                if self.inbox.is_stopped() {
                    return None;
                }
                self.inbox.count(|traffic| traffic.connections += 1);
                return Some(stream);
            }
            wait = (wait * 2).min(LAST_WAIT);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::addresses_of;

    #[test]
    fn an_address_is_on_this_machine_unless_it_says_otherwise() {
        for (text, expected) in [
            ("18945", "127.0.0.1:18945"),
            (":0", "127.0.0.1:0"),
            ("127.0.0.2", "127.0.0.2:18944"),
            ("192.0.2.7:5", "192.0.2.7:5"),
            ("[::1]:7", "[::1]:7"),
        ] {
            assert_eq!(addresses_of(text).unwrap()[0].to_string(), expected, "{text}");
        }
        for text in ["", "127.0.0.1:port", "127.0.0.1:70000", "no such host"] {
            assert!(addresses_of(text).is_err(), "{text}");
        }
    }
}
