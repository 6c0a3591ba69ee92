//! The loads on the service during the measurement of thumbnails.

use std::time::Duration;

use reqwest::Method;
use reqwest::header::ACCEPT;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::task::JoinSet;

use crate::cli::bench::service::args::{Load, ServiceArgs};
use crate::cli::bench::service::fixture::{Fixture, photographs};
use crate::cli::error::CommandResult;
use relume_api::cameras::{CameraSpec, LookAtSpec};
use relume_api::renders::RenderRequest;
use relume_api::{JobId, ModelId};
use relume_client::Client;
use relume_spec::rendering::{FrameFormat, Output};

/// More steps than the measurement can last.
const ENDLESS: u32 = 1_000_000;
/// Maximum time until a training starts.
const BEGINS_WITHIN: Duration = Duration::from_secs(60);
/// Time after which clients of renders disconnect.
const GOES_AWAY_AFTER: Duration = Duration::from_millis(200);
/// Open files of this process besides the two ends of each connection.
pub(super) const OTHER_FILES: usize = 600;

/// All outputs.
const ALL_OUTPUTS: [Output; 11] = [
    Output::Rgb,
    Output::Albedo,
    Output::Normal,
    Output::Metallic,
    Output::Roughness,
    Output::Visibility,
    Output::Depth,
    Output::Alpha,
    Output::Diffuse,
    Output::Specular,
    Output::Radiance,
];

/// The part of a request that a slow client sends before it stops.
const HALF_SENT: [&str; 3] = [
    "",
    "GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ",
    "POST /v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 1000\r\n\r\n{",
];

/// A load that lasts until [`ActiveLoad::end`].
pub(super) struct ActiveLoad {
    /// Description of the load with its parameters.
    title: String,
    /// Clients that repeat their requests without end.
    clients: JoinSet<()>,
    sockets: Vec<TcpStream>,
    training: Option<(Client, JobId)>,
}

impl ActiveLoad {
    /// Starts a load. The load is active when this function returns.
    pub(super) async fn begin(load: Load, fixture: &Fixture, args: &ServiceArgs) -> CommandResult<Self> {
        let mut active_load = Self {
            title: load.name().to_owned(),
            clients: JoinSet::new(),
            sockets: Vec::new(),
            training: None,
        };
        match load {
            Load::Idle => {}
            Load::Training => active_load.training = Some(begin_training(fixture).await?),
            Load::Uploads => active_load.begin_uploads(fixture, args).await?,
            Load::Renders => active_load.begin_renders(fixture, args),
            Load::Sockets => active_load.begin_sockets(fixture, args).await?,
        }
        Ok(active_load)
    }

    /// Stops the load and returns its description.
    pub(super) async fn end(mut self) -> CommandResult<String> {
        self.clients.shutdown().await;
        if let Some((client, job)) = &self.training {
            client.cancel_job(job).await?;
            client.wait(job, |_| {}).await?;
        }
        Ok(self.title)
    }

    /// Starts a client that submits the same upload for validation repeatedly.
    async fn begin_uploads(&mut self, fixture: &Fixture, args: &ServiceArgs) -> CommandResult {
        let (count, megapixels) = (args.photographs, args.megapixels);
        let archive = tokio::task::spawn_blocking(move || photographs(count, megapixels)).await??;
        let mebibytes = archive.len() >> 20;
        self.title = format!(
            "beside an upload of {count} JPEGs of {megapixels} megapixels, {mebibytes} MiB, being validated"
        );
        let client = fixture.client.clone();
        self.clients.spawn(async move {
            loop {
                if let Err(error) = client.validate_capture_bytes(archive.clone()).await {
                    eprintln!("an upload was refused: {error}");
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
            }
        });
        Ok(())
    }

    /// Starts clients that request large frames concurrently and disconnect before the answer.
    fn begin_renders(&mut self, fixture: &Fixture, args: &ServiceArgs) {
        let (count, size) = (args.renders, args.render_size);
        self.title = format!(
            "beside bursts of {count} renders of {size} x {size} px, all outputs as EXR, whose clients disconnect after {} ms",
            GOES_AWAY_AFTER.as_millis()
        );
        for _ in 0..count {
            let (client, model) = (fixture.client.clone(), fixture.model.clone());
            self.clients.spawn(async move {
                loop {
                    let render = render(&client, &model, size);
                    // Dropping the future closes its connection.
                    let answer = tokio::time::timeout(GOES_AWAY_AFTER, render).await;
                    if matches!(answer, Ok(Err(_))) {
                        tokio::time::sleep(GOES_AWAY_AFTER).await;
                    }
                }
            });
        }
    }

    /// Opens connections that have sent half a request and wait.
    async fn begin_sockets(&mut self, fixture: &Fixture, args: &ServiceArgs) -> CommandResult {
        let (files, _) = rlimit::getrlimit(rlimit::Resource::NOFILE)?;
        let most = usize::try_from(files).unwrap_or(usize::MAX).saturating_sub(OTHER_FILES) / 2;
        let wanted = args.sockets as usize;
        let base = fixture.client.base();
        let address = base.socket_addrs(|| None)?.into_iter().next().ok_or("the server has no address")?;
        for i in 0..wanted.min(most) {
            let mut stream = TcpStream::connect(address).await?;
            stream.write_all(HALF_SENT[i % HALF_SENT.len()].as_bytes()).await?;
            self.sockets.push(stream);
        }
        let fewer = if most < wanted {
            format!(" ({wanted} were requested; the limit of open files allows fewer)")
        } else {
            String::new()
        };
        self.title = format!("beside {} half-sent requests{fewer}", self.sockets.len());
        Ok(())
    }
}

/// Queues a training without an end and waits until it takes steps.
async fn begin_training(fixture: &Fixture) -> CommandResult<(Client, JobId)> {
    let client = fixture.client.clone();
    let job = client.create_job(&fixture.job(ENDLESS), None).await?.id;
    let begins = async {
        loop {
            let view = client.job(&job).await?;
            if view.state.is_terminal() {
                return Err(format!("the training ended {}", view.state.name()).into());
            }
            if view.progress.step > 0 {
                return CommandResult::Ok(());
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(BEGINS_WITHIN, begins).await??;
    Ok((client, job))
}

/// Renders a frame with all outputs as EXR and discards its bytes.
async fn render(client: &Client, model: &ModelId, size: u32) -> CommandResult {
    let look = LookAtSpec { eye: [2.5, -2.5, 1.5], target: [0.0; 3], up: [0.0, 0.0, 1.0], fov_y_deg: 40.0 };
    let request = RenderRequest {
        camera: CameraSpec { look_at: Some(look), ..CameraSpec::default() },
        width: size,
        height: size,
        outputs: ALL_OUTPUTS.to_vec(),
        ..RenderRequest::default()
    };
    let post = client.request(Method::POST, &format!("/v1/models/{model}/render"))?;
    let answer = post.header(ACCEPT, FrameFormat::Exr.media_type()).json(&request).send().await?;
    answer.error_for_status()?.bytes().await?;
    Ok(())
}
