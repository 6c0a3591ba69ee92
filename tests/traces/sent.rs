//! Spans that the program, as a process, sends to a collector.

use std::io::Read;
use std::process::{Command, Stdio};
use std::time::Duration;

use relume_api::JobId;
use relume_api::jobs::JobState;
use relume_client::Client;
use reqwest::Method;
use serde_json::json;
use tempfile::TempDir;

use crate::server_process::Server;
use crate::service_support::{capture_zip, ended, small_job};
use crate::traces::collector::{Collector, Sent};
use crate::traces::{CALLER, JOB_TRACE, post, traceparent};
use crate::workers::fleet::{Process, short_job, spawn_server, upload};

const RENDER_TRACE: &str = "0af7651916cd43dd8448eb211c80319c";
/// The kind of spans that answer a request.
const SERVER: i32 = 2;

/// The program, with only these OpenTelemetry variables. Batches are sent at the end of the process.
fn relume(variables: &[(&str, &str)]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    let inherited = std::env::vars().map(|(name, _)| name).filter(|name| name.starts_with("OTEL_"));
    for name in inherited {
        command.env_remove(name);
    }
    command.env("OTEL_BSP_SCHEDULE_DELAY", "600000").env_remove("RUST_LOG");
    command.envs(variables.iter().copied());
    command
}

/// Terminates a process with a signal and waits for its end.
async fn terminate(server: &mut Server) {
    let pid = rustix::process::Pid::from_child(&server.child);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    for _ in 0..1200 {
        if server.child.try_wait().unwrap().is_some() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("the server does not end");
}

/// Requests a frame with a `traceparent`.
async fn render(client: &Client, model: &str, traceparent: &str) {
    let look = json!({ "look_at": { "eye": [3, 0, 1], "target": [0, 0, 0], "fov_y_deg": 40 } });
    let frame = json!({ "camera": look, "width": 16, "height": 16, "environment": { "builtin": "studio" } });
    let request = client.request(Method::POST, &format!("/v1/models/{model}/render")).unwrap();
    let response = request.header("traceparent", traceparent).json(&frame).send().await.unwrap();
    assert_eq!(response.status(), 200);
}

/// Checks that every span with one of the names is a child of `parent`, and that there is at least one.
fn assert_children(collector: &Collector, names: &[&str], parent: &Sent) {
    for name in names {
        let found = collector.named(name);
        assert!(!found.is_empty(), "no {name}: {:#?}", collector.spans());
        for span in found {
            assert_eq!((&span.trace, &span.parent), (&parent.trace, &parent.id), "{span:?}");
        }
    }
}

/// Checks the spans of the steps of a job of 150 steps: consecutive ranges up to the end.
fn assert_steps(collector: &Collector) {
    let number = |span: &Sent, name| span.attribute(name).unwrap().parse::<u32>().unwrap();
    let steps = collector.named("steps");
    let stretches: Vec<_> = steps.iter().map(|span| (number(span, "first"), number(span, "last"))).collect();
    assert_eq!((stretches[0].0, stretches[stretches.len() - 1].1), (1, 150), "{stretches:?}");
    assert!(stretches.windows(2).all(|pair| pair[0].1 + 1 == pair[1].0), "{stretches:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_and_renders_are_spans_of_the_callers_trace() {
    let (collector, data) = (Collector::start().await, TempDir::new().unwrap());
    let endpoint = ("OTEL_EXPORTER_OTLP_ENDPOINT", &*collector.endpoint);
    let mut server = Server::start_under(relume(&[endpoint]), data.path());
    let client = server.client.clone();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let job = post(&client, &short_job(&capture), &[&traceparent(JOB_TRACE)]).await;
    let done = ended(&client, &JobId::from(job["id"].as_str().unwrap())).await;
    assert_eq!(done.state, JobState::Succeeded, "{:?}", done.error);
    render(&client, done.model.unwrap().as_str(), &traceparent(RENDER_TRACE)).await;
    terminate(&mut server).await;

    let posted = collector.one("POST /v1/jobs");
    assert_eq!((&*posted.trace, &*posted.parent, posted.kind), (JOB_TRACE, CALLER, SERVER));
    assert_eq!(posted.service, "relume");
    assert_eq!(posted.attribute("http.response.status_code").as_deref(), Some("202"));
    let attempt = collector.one("attempt");
    assert_children(&collector, &["attempt"], &posted);
    assert_eq!(attempt.attribute("job"), Some(done.id.to_string()));
    assert_eq!(attempt.attribute("number").as_deref(), Some("1"));
    assert_eq!(attempt.attribute("worker"), done.worker.map(|worker| worker.to_string()));
    assert!(attempt.attribute("device").is_some());
    let stages = ["prepare", "steps", "checkpoint", "evaluate", "publish"];
    assert_children(&collector, &stages, &attempt);
    assert_children(&collector, &["import", "dataset"], &collector.one("prepare"));
    assert_steps(&collector);

    let asked = collector.one("POST /v1/models/{id}/render");
    assert_eq!((&*asked.trace, &*asked.parent), (RENDER_TRACE, CALLER));
    assert_children(&collector, &["wait", "load_model", "prepare_light", "draw", "encode"], &asked);

    let other = collector.one("POST /v1/captures");
    assert!(
        ![JOB_TRACE, RENDER_TRACE].contains(&&*other.trace),
        "the control: a request without a caller's trace"
    );
    assert_eq!(other.parent, "", "begins one");
}

/// The number of batches of kernels in the trace of a short job on the GPU, with this filter.
async fn kernels(filter: &str) -> usize {
    let (collector, data) = (Collector::start().await, TempDir::new().unwrap());
    let variables = [
        ("OTEL_EXPORTER_OTLP_ENDPOINT", &*collector.endpoint),
        ("OTEL_BSP_MAX_QUEUE_SIZE", "100000"),
        ("RELUME_DEVICE", "gpu:0"),
        ("RELUME_TRACE_FILTER", filter),
    ];
    let mut server = Server::start_under(relume(&variables), data.path());
    let client = server.client.clone();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let job = client.create_job(&small_job(&capture, 10, 5), None).await.unwrap();
    let done = ended(&client, &job.id).await;
    assert_eq!(done.state, JobState::Succeeded, "{:?}", done.error);
    terminate(&mut server).await;
    let trace = collector.one("attempt").trace;
    let is_counted = |span: &Sent| span.attribute("dispatches").is_some_and(|count| count != "0");
    collector.named("kernels").iter().filter(|span| span.trace == trace && is_counted(span)).count()
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
async fn kernel_spans_are_sent_if_the_filter_enables_them() {
    assert!(kernels("relume=info,relume_engine=debug").await >= 10, "one for each step at the least");
    assert_eq!(kernels("relume=info").await, 0, "the control");
}

/// The names of the spans that a server sends for a request to `/healthz` with this `traceparent`.
async fn names_sent(variables: &[(&str, &str)], traceparent: &str) -> Vec<String> {
    let (collector, data) = (Collector::start().await, TempDir::new().unwrap());
    let named: Vec<_> = variables
        .iter()
        .map(|(name, value)| (*name, value.replace("COLLECTOR", &collector.endpoint)))
        .collect();
    let named: Vec<_> = named.iter().map(|(name, value)| (*name, &**value)).collect();
    let mut server = Server::start_under(relume(&named), data.path());
    let asked = server.client.request(Method::GET, "/healthz").unwrap().header("traceparent", traceparent);
    assert_eq!(asked.send().await.unwrap().status(), 200);
    terminate(&mut server).await;
    collector.spans().into_iter().map(|span| span.name).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn no_spans_are_sent_when_tracing_is_off() {
    let sampled = traceparent(JOB_TRACE);
    let endpoint = ("OTEL_EXPORTER_OTLP_ENDPOINT", "COLLECTOR");
    let traces = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "COLLECTOR/v1/traces");
    assert_eq!(names_sent(&[endpoint], &sampled).await, ["GET /healthz"], "the control");
    assert_eq!(names_sent(&[traces], &sampled).await, ["GET /healthz"], "nor does the other name go unheard");
    for quiet in [
        &[][..],
        &[endpoint, ("OTEL_SDK_DISABLED", "true")],
        &[endpoint, ("OTEL_TRACES_EXPORTER", "none")],
        &[endpoint, ("OTEL_TRACES_SAMPLER", "always_off")],
        &[endpoint, ("RELUME_TRACE_FILTER", "off")],
    ] {
        assert!(names_sent(quiet, &sampled).await.is_empty(), "{quiet:?}");
    }
    let unsampled = format!("00-{JOB_TRACE}-{CALLER}-00");
    assert!(names_sent(&[endpoint], &unsampled).await.is_empty(), "the caller does not record its trace");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unreachable_collector_gives_one_warning_and_no_delay() {
    // No server listens there any more.
    let away = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let endpoint = format!("http://{away}");
    let variables = [("OTEL_EXPORTER_OTLP_ENDPOINT", &*endpoint), ("OTEL_BSP_SCHEDULE_DELAY", "50")];
    let data = TempDir::new().unwrap();
    let log = std::fs::File::create(data.path().join("log")).unwrap();
    let mut command = relume(&variables);
    command.args(["serve", "--listen", "127.0.0.1:0", "--data-dir"]).arg(data.path().join("data"));
    let mut child = command.stdout(Stdio::piped()).stderr(log).spawn().unwrap();
    let mut line = [0; 64];
    let read = child.stdout.take().unwrap().read(&mut line).unwrap();
    let line = String::from_utf8_lossy(&line[..read]).into_owned();
    let client = Client::new(line.trim().strip_prefix("listening on ").unwrap(), None).unwrap();
    let mut server = Server { child, client };
    for _ in 0..20 {
        let asked = server.client.request(Method::GET, "/healthz").unwrap().send();
        let answer = tokio::time::timeout(Duration::from_secs(5), asked).await.unwrap().unwrap();
        assert_eq!(answer.status(), 200);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    terminate(&mut server).await;
    let log = std::fs::read_to_string(data.path().join("log")).unwrap();
    let warnings = log.lines().filter(|line| line.contains("accepts no spans")).count();
    assert_eq!(warnings, 1, "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_attempt_on_a_remote_worker_belongs_to_its_jobs_trace() {
    let (collector, folder) = (Collector::start().await, TempDir::new().unwrap());
    // This server runs in the test's process and sends no spans, so the job stores the caller's
    // `traceparent`.
    let server = spawn_server().await;
    let capture = upload(server.client()).await;
    let job = post(server.client(), &short_job(&capture), &[&traceparent(JOB_TRACE)]).await;
    let variables =
        [("OTEL_EXPORTER_OTLP_ENDPOINT", &*collector.endpoint), ("OTEL_SERVICE_NAME", "relume-worker")];
    let mut command = relume(&variables);
    command.args(["worker", "--device", "cpu", "--once", "--server", server.client().base().as_str()]);
    command.arg("--cache").arg(folder.path()).env_remove("RELUME_API_KEY");
    let mut worker = Process(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
    assert_eq!(worker.end().await.code(), Some(0));
    let attempt = collector.one("attempt");
    assert_eq!((&*attempt.trace, &*attempt.parent), (JOB_TRACE, CALLER));
    assert_eq!(attempt.attribute("job").as_deref(), job["id"].as_str());
    assert_eq!(attempt.service, "relume-worker");
    assert_children(&collector, &["prepare", "steps", "evaluate", "publish"], &attempt);
}
