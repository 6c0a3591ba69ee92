//! An S3 server in this process (s3s on a folder), with injected faults.

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::body::{Body, Bytes};
use futures::{StreamExt, stream};
use http_body_util::BodyExt;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use relume::store::ObjectStoreConfig;
use s3s::auth::SimpleAuth;
use s3s::service::{S3Service, S3ServiceBuilder};
use s3s_fs::FileSystem;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

use crate::service_support::files_under;

const KEY: &str = "test-key";
const SECRET: &str = "test-secret";
/// Prefix of all keys in the bucket.
const PREFIX: &str = "relume/test";
/// An unlimited number of faults.
pub const ALL: usize = usize::MAX;

/// The injected faults, and a record of the requests.
#[derive(Default)]
pub struct Faults {
    /// Number of requests that are answered with 503; the next field is a text in their target.
    pub refused: AtomicUsize,
    pub refused_of: Mutex<String>,
    /// Number of downloads whose connection ends halfway.
    pub cut: AtomicUsize,
    /// Number of downloads with a changed byte.
    pub flipped: AtomicUsize,
    /// Number of uploads whose connection ends without an answer.
    pub unanswered: AtomicUsize,
    /// Delay of each answer, milliseconds.
    pub slow: AtomicU64,
    /// Method and target of each request.
    pub seen: Mutex<Vec<String>>,
}

/// Whether the next request fails; decrements the counter.
fn one_of(count: &AtomicUsize) -> bool {
    count.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1)).is_ok()
}

impl Faults {
    pub fn set(&self, fault: &AtomicUsize, count: usize) {
        fault.store(count, Ordering::SeqCst);
    }

    /// Number of requests that begin with `begin`.
    pub fn count(&self, begin: &str) -> usize {
        self.seen.lock().unwrap().iter().filter(|seen| seen.starts_with(begin)).count()
    }
}

/// A bucket, deleted on drop.
pub struct Bucket {
    root: TempDir,
    address: SocketAddr,
    pub faults: Arc<Faults>,
    task: JoinHandle<()>,
}

impl Drop for Bucket {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Bucket {
    pub async fn start() -> Self {
        let root = TempDir::new().unwrap();
        std::fs::create_dir(root.path().join("bucket")).unwrap();
        let mut service = S3ServiceBuilder::new(FileSystem::new(root.path()).unwrap());
        service.set_auth(SimpleAuth::from_single(KEY, SECRET));
        let (service, faults) = (service.build(), Arc::new(Faults::default()));
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let task = tokio::spawn(serve(listener, service, faults.clone()));
        Self { root, address, faults, task }
    }

    /// The environment variables with which programs find it.
    pub fn settings(&self) -> [(String, String); 5] {
        [
            ("AWS_ACCESS_KEY_ID", KEY.to_owned()),
            ("AWS_SECRET_ACCESS_KEY", SECRET.to_owned()),
            ("AWS_REGION", "us-east-1".to_owned()),
            ("AWS_ENDPOINT_URL", format!("http://{}", self.address)),
            ("AWS_ALLOW_HTTP", "true".to_owned()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
    }

    pub fn url() -> String {
        format!("s3://bucket/{PREFIX}")
    }

    /// The configuration for servers, with shorter timeouts than the default.
    pub fn place(&self) -> ObjectStoreConfig {
        let place = ObjectStoreConfig::new(Self::url().parse().unwrap(), self.settings());
        ObjectStoreConfig {
            retry_timeout: Duration::from_millis(700),
            stall_timeout: Duration::from_secs(2),
            part_bytes: 5 << 20,
            ..place
        }
    }

    pub fn folder(&self) -> PathBuf {
        self.root.path().join("bucket").join(PREFIX)
    }

    /// The keys of all objects.
    pub fn keys(&self) -> Vec<String> {
        keys_under(&self.folder())
    }
}

/// The paths of all files under a folder.
pub fn keys_under(folder: &Path) -> Vec<String> {
    files_under(folder).into_iter().map(|(name, _)| name).collect()
}

async fn serve(listener: TcpListener, service: S3Service, faults: Arc<Faults>) {
    while let Ok((socket, _)) = listener.accept().await {
        let (service, faults) = (service.clone(), faults.clone());
        let answer = service_fn(move |request| answer(request, service.clone(), faults.clone()));
        tokio::spawn(http1::Builder::new().serve_connection(TokioIo::new(socket), answer));
    }
}

async fn answer(
    request: Request<Incoming>,
    service: S3Service,
    faults: Arc<Faults>,
) -> io::Result<Response<Body>> {
    let (method, target) = (request.method().clone(), request.uri().to_string());
    let short = target.replace(&format!("/bucket/{PREFIX}/"), "");
    faults.seen.lock().unwrap().push(format!("{method} {short}"));
    tokio::time::sleep(Duration::from_millis(faults.slow.load(Ordering::SeqCst))).await;
    let is_of = target.contains(faults.refused_of.lock().unwrap().as_str());
    if is_of && one_of(&faults.refused) {
        let mut refusal = Response::new(Body::empty());
        *refusal.status_mut() = StatusCode::SERVICE_UNAVAILABLE;
        return Ok(refusal);
    }
    if method == Method::PUT && one_of(&faults.unanswered) {
        return Err(io::Error::other("the connection ends"));
    }
    let is_object = method == Method::GET && !target.contains('?');
    let answer = service.call(request.map(s3s::Body::from)).await.map_err(io::Error::other)?;
    let (head, body) = answer.into_parts();
    let bytes = BodyExt::collect(body).await.map_err(io::Error::other)?.to_bytes();
    let body = match is_object && head.status.is_success() {
        true if one_of(&faults.cut) => cut(bytes),
        true if one_of(&faults.flipped) => flipped(bytes),
        _ => Body::from(bytes),
    };
    Ok(Response::from_parts(head, body))
}

/// The first half of the body, then an error.
fn cut(bytes: Bytes) -> Body {
    let half = bytes.slice(..bytes.len() / 2);
    let end = stream::once(async {
        // The delay makes sure that the first part has been sent.
        tokio::time::sleep(Duration::from_millis(20)).await;
        Err::<Bytes, _>(io::Error::other("the connection ends"))
    });
    Body::from_stream(stream::iter([Ok::<_, io::Error>(half)]).chain(end))
}

fn flipped(bytes: Bytes) -> Body {
    let mut bytes = bytes.to_vec();
    if let Some(byte) = bytes.get_mut(0) {
        *byte ^= 1;
    }
    Body::from(bytes)
}
