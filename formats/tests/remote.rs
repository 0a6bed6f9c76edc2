//! Volumes on servers: a web server that fails on request, Python's, and an S3 server.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use curvox_formats::{
    Error, ErrorKind, Format, OpenOptions, Region, Volume, Voxels, conformance, open, open_url,
};

use crate::server::{Act, Server};
use crate::sha256::sha256;

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures")
}

fn dataset(name: &str) -> OpenOptions {
    OpenOptions {
        dataset: Some(name.into()),
        ..OpenOptions::default()
    }
}

fn read(volume: Volume) -> Result<Vec<u8>, Error> {
    let mut planes = volume.into_forward();
    let (mut all, mut some) = (Vec::new(), Vec::new());
    while planes.read_planes(4, &mut some)? > 0 {
        all.extend_from_slice(&some);
    }
    planes.finish()?;
    Ok(all)
}

/// Opens and reads all, and gives the error of either.
fn failure(url: &str, options: &OpenOptions) -> Error {
    match open_url(url, options).and_then(read) {
        Ok(_) => panic!("{url}: an error was expected"),
        Err(error) => error,
    }
}

/// What a store gives from disk and by an address is the same.
fn check_same(base: &str, path: &str, options: &OpenOptions) {
    let url = format!("{base}/{path}");
    let here = open(&fixtures().join(path), options).unwrap();
    let there = open_url(&url, options).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(there.header.dims, here.header.dims, "{url}");
    assert_eq!(there.header.spacing, here.header.spacing, "{url}");
    assert_eq!(there.header.origin, here.header.origin, "{url}");
    assert_eq!(there.header.dtype(), here.header.dtype(), "{url}");
    assert!(read(there).unwrap() == read(here).unwrap(), "{url}");
}

/// Stores and files that are read by an address.
const READ: [(&str, Option<&str>); 11] = [
    ("zarr/v2_blosc.zarr", None),
    ("zarr/v2_bool_missing.zarr", None),
    ("zarr/v3_zstd.zarr", None),
    ("zarr/v3_shards.zarr", None),
    ("zarr/v3_shards_missing.zarr", None),
    ("zarr/ome05.zarr", None),
    ("zarr/ome05.zarr", Some("labels/ball")),
    ("zarr/series.zarr", Some("1")),
    ("n5/gzip.n5", None),
    ("n5/cosem.n5", Some("em")),
    ("npy/c.npy", None),
];

fn options_of(name: Option<&str>) -> OpenOptions {
    name.map_or_else(OpenOptions::default, dataset)
}

#[test]
fn a_server_gives_what_the_disk_gives() {
    let server = Server::new(&fixtures(), |_| Act::Serve);
    for (path, name) in READ {
        check_same(&server.url, path, &options_of(name));
    }
    let url = format!("{}/zarr/v3_shards.zarr/", server.url);
    conformance::check(|| open_url(&url, &OpenOptions::default())).unwrap();
    let region = OpenOptions {
        region: Some([2..5, 3..9, 1..2]),
        ..OpenOptions::default()
    };
    assert_eq!(open_url(&url, &region).unwrap().header.dims, [3, 6, 1]);
    check_same(&server.url, "npy/c.npy", &region);
}

#[test]
fn python_serves_stores_although_it_has_no_ranges() {
    let Some(mut child) = Command::new("python3")
        .args(["-u", "-m", "http.server", "--bind", "127.0.0.1", "0"])
        .current_dir(fixtures())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()
        .map(Killed)
    else {
        println!("SKIPPED: there is no python3");
        return;
    };
    let mut line = String::new();
    let out = child.0.stdout.take().unwrap();
    BufReader::new(out).read_line(&mut line).unwrap();
    let port: u16 = line
        .split(' ')
        .skip_while(|word| *word != "port")
        .nth(1)
        .and_then(|port| port.parse().ok())
        .unwrap_or_else(|| panic!("{line}"));
    for (path, name) in READ {
        check_same(&format!("http://127.0.0.1:{port}"), path, &options_of(name));
    }
}

/// A child that does not outlive the test.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn each_chunk_is_asked_for_once_and_each_index_of_a_shard_once() {
    let server = Server::new(&fixtures(), |_| Act::Serve);
    for path in ["zarr/v3_zstd.zarr", "zarr/v3_shards.zarr"] {
        let volume = open_url(&format!("{}/{path}", server.url), &OpenOptions::default()).unwrap();
        let dims = volume.header.dims;
        let Voxels::Random(voxels) = &volume.voxels else {
            panic!("chunks are read at random")
        };
        let before = server.requests().len();
        // Layers of chunks, each from two threads.
        let chunk = voxels.chunk().unwrap();
        for z in (0..dims[2]).step_by(chunk[2] as usize) {
            let part = |y: u64, size: u64| {
                let region = Region {
                    origin: [0, y, z],
                    size: [dims[0], size, chunk[2].min(dims[2] - z)],
                };
                voxels.read_box(&region, &mut Vec::new()).unwrap();
            };
            let half = chunk[1];
            std::thread::scope(|scope| {
                scope.spawn(|| part(0, half));
                scope.spawn(|| part(half, dims[1] - half));
            });
        }
        let mut requests = server.requests().split_off(before);
        let count = requests.len();
        requests.sort();
        requests.dedup();
        assert_eq!(requests.len(), count, "{path}: {requests:?}");
        assert!(count >= 4);
    }
}

/// Copies what is directly in a folder.
fn copy_files(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy_files(&path, &to);
        } else {
            std::fs::copy(&path, to).unwrap();
        }
    }
}

#[test]
fn consolidated_metadata_says_what_a_server_does_not_list() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    for store in ["two", "three"] {
        copy_files(
            &fixtures().join("zarr/v2_lz4.zarr"),
            &folder.path().join(store).join("deep/in"),
        );
    }
    write("two/.zgroup", r#"{"zarr_format": 2}"#);
    write(
        "two/.zmetadata",
        r#"{"metadata": {".zgroup": {}, "deep/.zgroup": {}, "deep/in/.zarray": {}}}"#,
    );
    write(
        "three/zarr.json",
        r#"{"zarr_format": 3, "node_type": "group", "attributes": {}, "consolidated_metadata":
        {"metadata": {"deep/in": {}}}}"#,
    );
    let server = Server::new(folder.path(), |_| Act::Serve);
    for store in ["two", "three"] {
        let url = format!("{}/{store}", server.url);
        let volume = open_url(&url, &OpenOptions::default()).unwrap();
        assert_eq!(volume.header.dims, [13, 11, 9]);
        read(volume).unwrap();
    }
    write(
        "two/.zmetadata",
        r#"{"metadata": {"../three/deep/in/.zarray": {}}}"#,
    );
    let error = failure(&format!("{}/two", server.url), &OpenOptions::default());
    assert!(
        error.to_string().contains("leaves the container"),
        "{error}"
    );
}

#[test]
fn parts_of_a_shard_are_asked_for_not_all_of_it() {
    let server = Server::new(&fixtures(), |_| Act::Serve);
    let url = format!("{}/zarr/v3_shards.zarr", server.url);
    let volume = open_url(&url, &OpenOptions::default()).unwrap();
    read(volume).unwrap();
    let requests = server.requests();
    let shards: Vec<_> = requests.iter().filter(|r| r.contains("/c/")).collect();
    assert!(!shards.is_empty());
    assert!(shards.iter().all(|request| !request.ends_with(" all")));
}

#[test]
fn a_server_that_fails_and_breaks_off_is_asked_again() {
    let server = Server::new(&fixtures(), |asked| match asked.before {
        0 => Act::Status("503 Service Unavailable"),
        1 if asked.path.contains("/c/") => Act::Cut(20),
        _ => Act::Serve,
    });
    check_same(&server.url, "zarr/v3_zstd.zarr", &OpenOptions::default());
}

#[test]
fn a_stream_that_breaks_off_goes_on_where_it_was() {
    let server = Server::new(&fixtures(), |asked| match asked.range {
        None => Act::Cut(1000),
        Some("bytes=1000-") => Act::Cut(700),
        Some(_) => Act::Serve,
    });
    check_same(&server.url, "npy/c.npy", &OpenOptions::default());
    let server = Server::new(&fixtures(), |asked| match asked.range {
        None => Act::Cut(1000),
        Some(_) => Act::ServeWhole,
    });
    let error = failure(
        &format!("{}/npy/c.npy", server.url),
        &OpenOptions::default(),
    );
    assert!(
        error.to_string().contains("does not serve the rest"),
        "{error}"
    );
}

#[test]
fn a_server_that_never_recovers_is_an_error_soon() {
    let server = Server::new(&fixtures(), |asked| {
        if asked.path.contains("/c/") {
            Act::Status("500 Internal Server Error")
        } else {
            Act::Serve
        }
    });
    let begin = Instant::now();
    let url = format!("{}/zarr/v3_zstd.zarr", server.url);
    let error = failure(&url, &OpenOptions::default());
    assert_eq!(error.kind(), ErrorKind::Io);
    assert!(error.to_string().contains("/c/0/0/0: no answer"), "{error}");
    assert!(error.to_string().contains("500"), "{error}");
    assert!(begin.elapsed() < Duration::from_secs(20));
}

#[test]
fn refusals_redirects_and_missing_volumes_say_what_they_are() {
    let server = Server::new(&fixtures(), |asked| {
        let there = |path: &str| asked.path.starts_with(path);
        if there("/round") {
            Act::Redirect("/round".into())
        } else if there("/moved/") {
            Act::Redirect(asked.path.replacen("/moved/", "/zarr/", 1))
        } else if there("/secret") || asked.path.contains("v2_blosc.zarr/0/0/0") {
            Act::Status("403 Forbidden")
        } else if there("/html") {
            Act::Bytes(b"<html>".to_vec())
        } else {
            Act::Serve
        }
    });
    let plain = OpenOptions::default();
    for (path, parts) in [
        ("zarr/none.zarr", ["404", "none.zarr"]),
        ("npy/none.npy", ["404", "none.npy"]),
        ("secret.zarr", ["403", "refused"]),
        ("secret.npy", ["403", "refused"]),
        ("zarr/v2_blosc.zarr", ["403", "v2_blosc.zarr/0/0/0"]),
        ("round.zarr", ["redirects too often", "round.zarr"]),
        ("html.zarr", ["is not JSON", "html.zarr/zarr.json"]),
        ("zarr/groups.zarr", ["cannot be listed", "--dataset"]),
        ("zarr/series.zarr", ["0 (image), 1 (image)", "--dataset"]),
    ] {
        let url = format!("{}/{path}?token=geheim", server.url);
        let error = failure(&url, &plain).to_string();
        for part in parts {
            assert!(error.contains(part), "{error}");
        }
        assert!(!error.contains("geheim"), "{error}");
    }
    // A token is part of every request, but not of where the server redirects to.
    let sent = |request: &String| request.contains("?token=geheim");
    let requests = server.requests();
    assert!(requests.iter().all(|r| sent(r) || r.starts_with("/round ")));
    let url = format!("{}/moved/v3_zstd.zarr", server.url);
    read(open_url(&url, &plain).unwrap()).unwrap();
    let refused = failure("http://127.0.0.1:1/a.zarr", &plain).to_string();
    assert!(refused.contains("127.0.0.1:1"), "{refused}");
    let tls = failure(&server.url.replace("http:", "https:"), &plain).to_string();
    assert!(
        tls.contains("secure connection") || tls.contains("connection fails"),
        "{tls}"
    );
    let user = failure("http://me:geheim@127.0.0.1/a.zarr", &plain).to_string();
    assert!(
        user.contains("user or password") && !user.contains("geheim"),
        "{user}"
    );
}

#[test]
fn an_answer_without_end_is_read_up_to_what_a_chunk_may_have() {
    let server = Server::new(&fixtures(), |asked| {
        if asked.path.contains("/c/") {
            Act::Endless
        } else {
            Act::Serve
        }
    });
    let url = format!("{}/zarr/v3_zstd.zarr", server.url);
    let error = failure(&url, &OpenOptions::default()).to_string();
    assert!(error.contains("at most"), "{error}");
}

#[test]
fn a_shard_that_changes_between_its_index_and_a_chunk_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let from = fixtures().join("zarr/v3_shards.zarr");
    let shard = folder.path().join("c/0/0/0");
    std::fs::create_dir_all(shard.parent().unwrap()).unwrap();
    std::fs::copy(from.join("zarr.json"), folder.path().join("zarr.json")).unwrap();
    let mut bytes = std::fs::read(from.join("c/0/0/0")).unwrap();
    std::fs::write(&shard, &bytes).unwrap();
    let server = Server::new(folder.path(), |_| Act::Serve);
    let volume = open_url(&server.url, &OpenOptions::default()).unwrap();
    let disk = open(
        folder.path(),
        &OpenOptions {
            format: Some(Format::Zarr),
            ..OpenOptions::default()
        },
    )
    .unwrap();
    let one = |volume: &Volume| {
        let Voxels::Random(voxels) = &volume.voxels else {
            panic!("chunks are read at random")
        };
        let region = Region {
            origin: [0; 3],
            size: [2; 3],
        };
        voxels.read_box(&region, &mut Vec::new())
    };
    for volume in [&volume, &disk] {
        one(volume).unwrap();
    }
    bytes.insert(0, 0);
    std::fs::write(&shard, &bytes).unwrap();
    for volume in [&volume, &disk] {
        let error = one(volume).unwrap_err().to_string();
        assert!(error.contains("changed while it was read"), "{error}");
    }
}

/// Runs in a process of its own, with the variables the test gives it.
#[test]
#[ignore = "started by other tests"]
fn child() {
    let Ok(url) = std::env::var("CURVOX_TEST_URL") else {
        return;
    };
    let options = options_of(std::env::var("CURVOX_TEST_DATASET").ok().as_deref());
    match open_url(&url, &options) {
        Ok(volume) => {
            println!("opened {volume:?}");
            match read(volume) {
                Ok(voxels) => println!("voxels {}", sha256(&voxels)),
                Err(error) => println!("failed: {error} {error:?}"),
            }
        }
        Err(error) => println!("failed: {error} {error:?}"),
    }
}

/// What the child prints with these variables and no others of AWS.
fn child_says(variables: &[(&str, &str)]) -> String {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "remote::child", "--ignored", "--nocapture"]);
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("AWS_")) {
        command.env_remove(name);
    }
    let home = tempfile::tempdir().unwrap();
    command.env("HOME", home.path());
    command.envs(variables.iter().copied());
    let output = command.output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    String::from_utf8_lossy(&text).into_owned()
}

#[test]
fn a_silent_server_is_given_up() {
    let server = Server::new(&fixtures(), |asked| {
        if asked.path.contains("/c/") {
            Act::Silence(Duration::from_secs(5))
        } else {
            Act::Serve
        }
    });
    let begin = Instant::now();
    let url = format!("{}/zarr/v3_zstd.zarr", server.url);
    let said = child_says(&[("CURVOX_TEST_URL", &url), ("CURVOX_HTTP_TIMEOUT", "1")]);
    assert!(said.contains("the server is silent"), "{said}");
    assert!(begin.elapsed() < Duration::from_secs(20));
}

#[test]
fn a_bucket_gives_what_the_disk_gives_to_those_who_may() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/moto_server.py");
    let started = Command::new("python3")
        .arg(script)
        .arg(fixtures())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let mut line = String::new();
    let mut child = match started {
        Ok(child) => Killed(child),
        Err(_) => {
            println!("SKIPPED: there is no python3");
            return;
        }
    };
    let out = child.0.stdout.take().unwrap();
    BufReader::new(out).read_line(&mut line).unwrap();
    let words: Vec<_> = line.split_whitespace().collect();
    let [port, access, secret, lists, anonymous] = words[..] else {
        println!("SKIPPED: there is no S3 server, moto[server] is not installed");
        return;
    };
    let endpoint = format!("http://127.0.0.1:{port}");
    let keys = [
        ("AWS_ENDPOINT_URL", endpoint.as_str()),
        ("AWS_ACCESS_KEY_ID", access),
        ("AWS_SECRET_ACCESS_KEY", secret),
    ];
    let says = |path: &str, name: Option<&str>, variables: &[(&str, &str)]| {
        let url = format!("s3://volumes/of mine/{path}");
        let mut all = vec![("CURVOX_TEST_URL", url.as_str())];
        all.extend(name.map(|name| ("CURVOX_TEST_DATASET", name)));
        all.extend(variables);
        let said = child_says(&all);
        for hidden in [secret, access, "Signature=", "geheim"] {
            assert!(!said.contains(hidden), "{said}");
        }
        said
    };
    for (path, name) in READ {
        let here = open(&fixtures().join(path), &options_of(name)).unwrap();
        let voxels = sha256(&read(here).unwrap());
        let said = says(path, name, &keys);
        assert!(said.contains(&format!("voxels {voxels}")), "{said}");
    }
    // A bucket can be listed, by whom the server lets list: the client of AWS says whether it does.
    let said = says("zarr/groups.zarr", None, &keys);
    let expected = match lists {
        "lists" => "a (9 x 11 x 13), b (9 x 11 x 13)",
        _ => "SignatureDoesNotMatch",
    };
    assert!(said.contains(expected), "{lists}: {said}");

    // The same keys in a profile.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("credentials");
    std::fs::write(
        &file,
        format!("[lab]\naws_access_key_id={access}\naws_secret_access_key={secret}\n"),
    )
    .unwrap();
    let profile = [
        ("AWS_ENDPOINT_URL", endpoint.as_str()),
        ("AWS_PROFILE", "lab"),
        ("AWS_SHARED_CREDENTIALS_FILE", file.to_str().unwrap()),
    ];
    let said = says("zarr/v3_shards.zarr", None, &profile);
    assert!(said.contains("voxels "), "{said}");

    // Wrong keys, none, and half of them.
    let wrong = [keys[0], keys[1], ("AWS_SECRET_ACCESS_KEY", "geheim")];
    let said = says("zarr/v3_zstd.zarr", None, &wrong);
    assert!(said.contains("SignatureDoesNotMatch"), "{said}");
    let said = says("zarr/v3_zstd.zarr", None, &keys[..1]);
    let expected = match anonymous {
        "200" => "voxels ",
        _ => "failed: s3://volumes/of mine/zarr/v3_zstd.zarr/",
    };
    assert!(said.contains(expected), "{anonymous}: {said}");
    let said = says("zarr/v3_zstd.zarr", None, &keys[..2]);
    assert!(said.contains("AWS_SECRET_ACCESS_KEY is not"), "{said}");
    let said = says("zarr/none.zarr", None, &keys);
    let expected = match lists {
        "lists" => "404",
        _ => "SignatureDoesNotMatch",
    };
    assert!(said.contains(expected), "{lists}: {said}");
}
