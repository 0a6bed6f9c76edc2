//! A small web server on the loopback interface, which serves a folder and fails on request.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// What the server does with a request.
#[derive(Clone, Debug)]
pub enum Act {
    /// The file, or the part of it that is asked for.
    Serve,
    /// The whole file, whatever part is asked for.
    ServeWhole,
    /// Nothing but a status, such as `503 Service Unavailable`.
    Status(&'static str),
    /// The first bytes, and then the connection ends.
    Cut(usize),
    /// No answer.
    Silence(Duration),
    /// Somewhere else.
    Redirect(String),
    /// More bytes than any file has, without end.
    Endless,
    /// Other bytes than the file's.
    Bytes(Vec<u8>),
}

/// A request: its path with the query, how often it came before, and its range.
pub struct Asked<'a> {
    pub path: &'a str,
    pub before: usize,
    pub range: Option<&'a str>,
}

type Decide = dyn Fn(&Asked<'_>) -> Act + Send + Sync;

/// The server. Its threads end with the test binary.
pub struct Server {
    pub url: String,
    log: Arc<Mutex<Vec<String>>>,
}

impl Server {
    /// Serves a folder.
    pub fn new(folder: &Path, decide: impl Fn(&Asked<'_>) -> Act + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let log = Arc::new(Mutex::new(Vec::new()));
        let counts = Arc::new(Mutex::new(HashMap::new()));
        let decide: Arc<Decide> = Arc::new(decide);
        let (folder, its_log) = (folder.to_path_buf(), Arc::clone(&log));
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (folder, log) = (folder.clone(), Arc::clone(&its_log));
                let (counts, decide) = (Arc::clone(&counts), Arc::clone(&decide));
                std::thread::spawn(move || {
                    let _ = connection(stream, &folder, &log, &counts, &*decide);
                });
            }
        });
        Self { url, log }
    }

    /// Requests so far, as `PATH RANGE`.
    pub fn requests(&self) -> Vec<String> {
        self.log.lock().unwrap().clone()
    }
}

fn connection(
    stream: TcpStream,
    folder: &Path,
    log: &Mutex<Vec<String>>,
    counts: &Mutex<HashMap<String, usize>>,
    decide: &Decide,
) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut stream = BufWriter::new(stream);
    loop {
        stream.flush()?;
        let mut line = String::new();
        if reader.read_line(&mut line)? == 0 {
            return Ok(());
        }
        let path = line.split(' ').nth(1).unwrap_or("/").to_string();
        let mut range = None;
        loop {
            let mut header = String::new();
            reader.read_line(&mut header)?;
            let Some((name, value)) = header.trim().split_once(':') else {
                break;
            };
            if name.eq_ignore_ascii_case("range") {
                range = Some(value.trim().to_string());
            }
        }
        let shown = range.as_deref().unwrap_or("all");
        log.lock().unwrap().push(format!("{path} {shown}"));
        let before = {
            let mut counts = counts.lock().unwrap();
            let count = counts.entry(path.clone()).or_insert(0);
            *count += 1;
            *count - 1
        };
        let act = decide(&Asked {
            path: &path,
            before,
            range: range.as_deref(),
        });
        let path = path.split('?').next().unwrap_or_default();
        let path = path.replace("%20", " ");
        let file: PathBuf = folder.join(path.trim_matches('/'));
        let content = std::fs::read(&file).ok();
        match act {
            Act::Silence(time) => {
                std::thread::sleep(time);
                return Ok(());
            }
            Act::Status(status) => {
                write!(stream, "HTTP/1.1 {status}\r\ncontent-length: 4\r\n\r\nbusy")?;
            }
            Act::Redirect(to) => {
                write!(
                    stream,
                    "HTTP/1.1 302 Found\r\nlocation: {to}\r\ncontent-length: 0\r\n\r\n"
                )?;
            }
            Act::Endless => {
                write!(stream, "HTTP/1.1 200 OK\r\nconnection: close\r\n\r\n")?;
                let zeros = vec![0; 1 << 16];
                loop {
                    stream.write_all(&zeros)?;
                }
            }
            Act::Bytes(bytes) => {
                let length = bytes.len();
                write!(
                    stream,
                    "HTTP/1.1 200 OK\r\ncontent-length: {length}\r\n\r\n"
                )?;
                stream.write_all(&bytes)?;
            }
            Act::Serve | Act::ServeWhole | Act::Cut(_) => {
                let Some(content) = content else {
                    write!(
                        stream,
                        "HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\n\r\n"
                    )?;
                    continue;
                };
                let whole = matches!(act, Act::ServeWhole);
                let part = range.filter(|_| !whole);
                let (status, head, body) = match part.map(|part| cut(&part, content.len())) {
                    None => ("200 OK", String::new(), &content[..]),
                    Some(None) => ("416 Range Not Satisfiable", String::new(), &[][..]),
                    Some(Some((from, to))) => (
                        "206 Partial Content",
                        format!(
                            "content-range: bytes {from}-{}/{}\r\n",
                            to - 1,
                            content.len()
                        ),
                        &content[from..to],
                    ),
                };
                let length = body.len();
                write!(
                    stream,
                    "HTTP/1.1 {status}\r\n{head}etag: \"{}\"\r\ncontent-length: {length}\r\n\r\n",
                    content.len()
                )?;
                if let Act::Cut(most) = act {
                    stream.write_all(&body[..most.min(length)])?;
                    return Ok(());
                }
                stream.write_all(body)?;
            }
        }
    }
}

/// The bytes of `bytes=A-B`, `bytes=A-` or `bytes=-N`.
fn cut(range: &str, length: usize) -> Option<(usize, usize)> {
    let (from, to) = range.strip_prefix("bytes=")?.split_once('-')?;
    let (from, to) = match (from.parse::<usize>(), to.parse::<usize>()) {
        (Ok(from), Ok(to)) => (from, (to + 1).min(length)),
        (Ok(from), Err(_)) => (from, length),
        (Err(_), Ok(count)) => (length.saturating_sub(count), length),
        _ => return None,
    };
    (from < to).then_some((from, to))
}
