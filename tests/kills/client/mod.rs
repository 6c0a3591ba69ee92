//! A client that sends random requests, one after another, and records the answers.

mod models;
mod poses;

use std::collections::{BTreeMap, BTreeSet};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume_api::jobs::{JobChange, JobState, JobView, NewJob};
use relume_api::keys::{NewKey, Scope};
use relume_api::metadata::MetadataChange;
use relume_api::webhooks::{NewWebhook, WebhookEvent};
use relume_client::{Client, ClientError};
use reqwest::Method;

use crate::kills::known::{Fate, Kind, Thing};
use crate::service_support::{CaptureZip, small_job};

/// The reason why a client stops.
#[derive(Debug)]
pub enum Stop {
    /// The server is gone.
    Killed,
    /// The state contradicts an earlier answer.
    Wrong(String),
}

impl Stop {
    /// The contradiction, if there is one.
    pub fn wrong(self) -> Option<String> {
        match self {
            Self::Killed => None,
            Self::Wrong(what) => Some(what),
        }
    }
}

/// A refusal, by its status.
type Answer<T> = Result<Result<T, u16>, Stop>;

/// Distinguishes the end of the server from its refusals.
fn told<T>(answer: Result<T, ClientError>) -> Answer<T> {
    match answer {
        Ok(answer) => Ok(Ok(answer)),
        Err(ClientError::Problem(problem)) if problem.status < 500 => Ok(Err(problem.status)),
        Err(ClientError::Transport(_)) => Err(Stop::Killed),
        Err(error) => Err(Stop::Wrong(error.to_string())),
    }
}

/// The resource in an answer; `None` for 404.
fn found<T>(answer: Result<T, ClientError>) -> Result<Option<T>, Stop> {
    match told(answer)? {
        Ok(thing) => Ok(Some(thing)),
        Err(404) => Ok(None),
        Err(status) => Err(Stop::Wrong(format!("refused with {status}"))),
    }
}

/// Accepts an expected refusal: the resource is needed, busy or has ended.
fn done_or_in_the_way<T>(answer: Answer<T>) -> Result<Option<T>, Stop> {
    match answer? {
        Ok(answer) => Ok(Some(answer)),
        Err(409 | 423) => Ok(None),
        Err(status) => Err(Stop::Wrong(format!("refused with {status}"))),
    }
}

#[derive(Clone)]
pub struct Requests {
    random: ChaCha8Rng,
    /// Number of this client, which makes its content unique.
    number: u64,
    made: u64,
    things: Vec<Thing>,
    /// A submission without an answer, with its idempotency key. It is repeated before other requests.
    unanswered: Option<(NewJob, String)>,
    pub answered: u64,
    /// Number of sets of photographs whose poses the server found.
    pub posed: u64,
    /// Number of calibrations that were made or undone.
    pub calibrated: u64,
    counts: BTreeMap<Kind, usize>,
}

impl Requests {
    pub fn new(seed: u64, number: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(number + 1);
        let (things, counts) = (Vec::new(), BTreeMap::new());
        Self {
            random,
            number,
            made: 0,
            things,
            unanswered: None,
            answered: 0,
            posed: 0,
            calibrated: 0,
            counts,
        }
    }

    /// Number of resources of each kind that all clients created.
    pub fn counts(clients: &[Self]) -> BTreeMap<Kind, usize> {
        let mut sums = BTreeMap::new();
        let counts = clients.iter().flat_map(|requests| &requests.counts);
        counts.for_each(|(kind, count)| *sums.entry(*kind).or_insert(0) += count);
        sums
    }

    /// Whether a list has an item in a state.
    pub async fn any_in_state(client: &Client, list: &str, state: &str) -> bool {
        let request = client.request(Method::GET, &format!("/v1/{list}?state={state}")).unwrap();
        let list = request.send().await.unwrap().text().await.unwrap();
        let list: serde_json::Value = serde_json::from_str(&list).unwrap();
        !list["items"].as_array().unwrap().is_empty()
    }

    /// Indices of the existing resources of a kind.
    pub fn kept(&self, kind: Kind) -> Vec<usize> {
        let is_kept = |place: &usize| {
            let thing = &self.things[*place];
            thing.kind == kind && thing.fate == Fate::Kept
        };
        (0..self.things.len()).filter(is_kept).collect()
    }

    fn any(&mut self, kind: Kind) -> Option<usize> {
        let kept = self.kept(kind);
        (!kept.is_empty()).then(|| kept[self.random.random_range(0..kept.len())])
    }

    fn add(&mut self, thing: Thing) {
        *self.counts.entry(thing.kind).or_default() += 1;
        self.things.push(thing);
    }

    /// A capture with unique content.
    fn archive(&mut self) -> Vec<u8> {
        self.made += 1;
        let mut capture = CaptureZip::new(6, 16);
        let name = format!("{} of {}", self.made, self.number);
        capture.images.push(("note.txt".to_owned(), name.into_bytes()));
        capture.zip()
    }

    /// Sends requests until the server ends or an answer is wrong.
    pub async fn go_on(&mut self, client: &Client) -> Stop {
        loop {
            if let Err(stop) = self.request(client).await {
                return stop;
            }
            self.answered += 1;
        }
    }

    async fn request(&mut self, client: &Client) -> Result<(), Stop> {
        if self.unanswered.is_some() {
            return self.submit(client).await;
        }
        match self.random.random_range(0..100) {
            0..12 => self.upload(client).await,
            12..27 => self.upload_in_pieces(client).await,
            27..30 => self.upload_or_delete_photographs(client).await,
            30..42 => self.submit(client).await,
            42..50 => self.cancel(client).await,
            50..54 => self.retry(client).await,
            54..60 => self.delete_job(client).await,
            60..66 => self.delete_capture(client).await,
            66..72 => self.delete_other(client).await,
            72..78 => self.upload_environment(client).await,
            78..84 => self.make_or_revoke_key(client).await,
            84..87 => self.make_webhook(client).await,
            87..92 => self.make_or_delete_export(client).await,
            92..95 => self.calibrate_or_undo(client).await,
            _ => self.rename(client).await,
        }
    }

    async fn upload(&mut self, client: &Client) -> Result<(), Stop> {
        if self.kept(Kind::Capture).len() >= 3 {
            return self.delete_capture(client).await;
        }
        let capture = told(client.upload_capture_bytes(self.archive()).await)?;
        let capture = capture.map_err(|status| Stop::Wrong(format!("an upload: {status}")))?;
        self.add(Thing::new(Kind::Capture, capture.id));
        Ok(())
    }

    /// Creates an upload, sends its next part, or makes a capture of it.
    async fn upload_in_pieces(&mut self, client: &Client) -> Result<(), Stop> {
        let refused = |status| Stop::Wrong(format!("an upload in pieces: {status}"));
        let Some(place) = self.any(Kind::Upload) else {
            let archive = self.archive();
            let id = told(client.begin_upload(archive.len() as u64).await)?.map_err(refused)?;
            self.add(Thing { archive, ..Thing::new(Kind::Upload, id) });
            return Ok(());
        };
        let upload = &mut self.things[place];
        let (id, whole, at) = (upload.id.as_str().into(), upload.archive.len(), upload.offset);
        if at < whole {
            let end = (at + self.random.random_range(1..=whole / 2)).min(whole);
            let sent = told(client.send_piece(&id, at as u64, upload.archive[at..end].to_vec()).await);
            if let Some(offset) = done_or_in_the_way(sent)? {
                upload.offset = usize::try_from(offset).unwrap();
            }
            return Ok(());
        }
        upload.fate = Fate::Either;
        match done_or_in_the_way(told(client.capture_of_upload(&id).await))? {
            Some(capture) => {
                upload.fate = Fate::Deleted;
                self.add(Thing::new(Kind::Capture, capture.id));
            }
            None => self.things[place].fate = Fate::Kept,
        }
        Ok(())
    }

    /// Submits a job, or repeats the submission that got no answer. The job exists once in both cases.
    async fn submit(&mut self, client: &Client) -> Result<(), Stop> {
        if self.unanswered.is_none() {
            let Some(capture) = self.any(Kind::Capture) else { return self.upload(client).await };
            self.made += 1;
            let key = format!("{}-{}", self.number, self.made);
            let steps = self.random.random_range(1..12);
            let mut job = small_job(&self.things[capture].id.as_str().into(), steps, 4);
            (job.overrides.resolution, job.external_id) = (Some(16), Some(key.clone()));
            job.priority = self.random.random_range(-5..=5);
            self.unanswered = Some((job, key));
        }
        let Some((job, key)) = self.unanswered.clone() else { return Ok(()) };
        match told(client.create_job(&job, Some(&key)).await)? {
            Ok(view) => self.add(Thing { parent: job.capture.to_string(), ..Thing::new(Kind::Job, view.id) }),
            // Its capture may be in deletion.
            Err(422) => {}
            Err(status) => return Err(Stop::Wrong(format!("a submission: {status}"))),
        }
        self.unanswered = None;
        let path = format!("/v1/jobs?external_id={key}");
        let list = client.request(Method::GET, &path).unwrap().send().await.map_err(|_| Stop::Killed)?;
        let list: serde_json::Value = match list.bytes().await {
            Ok(bytes) => serde_json::from_slice(&bytes).map_err(|error| Stop::Wrong(error.to_string()))?,
            Err(_) => return Err(Stop::Killed),
        };
        match list["items"].as_array().map(Vec::len) {
            Some(0 | 1) => Ok(()),
            _ => Err(Stop::Wrong(format!("not one job with the key {key}: {list}"))),
        }
    }

    async fn cancel(&mut self, client: &Client) -> Result<(), Stop> {
        let Some(place) = self.any(Kind::Job) else { return Ok(()) };
        let id = self.things[place].id.as_str().into();
        let Some(view) = done_or_in_the_way(told(client.cancel_job(&id).await))? else { return Ok(()) };
        self.things[place].stopping = true;
        self.things[place].settle_state(view.state).map_err(Stop::Wrong)
    }

    async fn retry(&mut self, client: &Client) -> Result<(), Stop> {
        let Some(place) = self.any(Kind::Job) else { return Ok(()) };
        let Thing { id, parent, names, .. } = self.things[place].clone();
        if let Some(view) = done_or_in_the_way(told(client.retry_job(&id.as_str().into()).await))? {
            // A retry has the name of the job that it repeats.
            self.add(Thing { parent, names, ..Thing::new(Kind::Job, view.id) });
        }
        Ok(())
    }

    async fn delete_job(&mut self, client: &Client) -> Result<(), Stop> {
        let Some(place) = self.any(Kind::Job) else { return Ok(()) };
        self.things[place].fate = Fate::Either;
        let (id, cascade) = (self.things[place].id.as_str().into(), self.random.random_bool(0.7));
        let deleted = done_or_in_the_way(told(client.delete_job(&id, cascade).await))?;
        self.things[place].fate = if deleted.is_some() { Fate::Deleted } else { Fate::Kept };
        Ok(())
    }

    /// Deletes a capture with its jobs, except jobs with a model.
    async fn delete_capture(&mut self, client: &Client) -> Result<(), Stop> {
        let Some(place) = self.any(Kind::Capture) else { return Ok(()) };
        let capture = self.things[place].id.clone();
        let cascade = self.random.random_bool(0.8);
        self.things[place].fate = Fate::Either;
        let of_it = |thing: &&mut Thing| thing.parent == capture && thing.fate == Fate::Kept;
        if cascade {
            self.things.iter_mut().filter(of_it).for_each(|job| job.fate = Fate::Either);
        }
        let deleted =
            done_or_in_the_way(told(client.delete_capture(&capture.as_str().into(), cascade).await))?;
        self.things[place].fate = if deleted.is_some() { Fate::Deleted } else { Fate::Kept };
        self.verify_jobs(client).await
    }

    async fn delete_other(&mut self, client: &Client) -> Result<(), Stop> {
        let kinds = [Kind::Environment, Kind::Model, Kind::Webhook, Kind::Upload];
        let kind = kinds[self.random.random_range(0..kinds.len())];
        let Some(place) = self.any(kind) else { return Ok(()) };
        self.things[place].fate = Fate::Either;
        if kind == Kind::Model {
            self.forget_exports_of(&self.things[place].id.clone());
        }
        let id = self.things[place].id.as_str();
        let answer = match kind {
            Kind::Environment => client.delete_environment(&id.into(), false).await,
            Kind::Model => client.delete_model(&id.into()).await,
            Kind::Webhook => client.delete_webhook(&id.into()).await,
            _ => client.delete_upload(&id.into()).await,
        };
        let deleted = done_or_in_the_way(told(answer))?;
        self.things[place].fate = if deleted.is_some() { Fate::Deleted } else { Fate::Kept };
        Ok(())
    }

    async fn upload_environment(&mut self, client: &Client) -> Result<(), Stop> {
        if self.kept(Kind::Environment).len() >= 3 {
            return Ok(());
        }
        self.made += 1;
        let mut map = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n".to_vec();
        let [high, low] = u16::try_from(self.made).unwrap().to_be_bytes();
        map.extend([128, high, low, 129 + u8::try_from(self.number).unwrap()].repeat(4 * 8));
        let view = told(client.upload_environment(map).await)?;
        let view = view.map_err(|status| Stop::Wrong(format!("a map: {status}")))?;
        self.add(Thing::new(Kind::Environment, view.id));
        Ok(())
    }

    async fn make_or_revoke_key(&mut self, client: &Client) -> Result<(), Stop> {
        if let Some(place) = self.any(Kind::Key).filter(|_| self.kept(Kind::Key).len() >= 3) {
            self.things[place].fate = Fate::Either;
            let id = self.things[place].id.as_str().into();
            let revoked = told(client.revoke_key(&id).await)?;
            revoked.map_err(|status| Stop::Wrong(format!("a revocation: {status}")))?;
            self.things[place].fate = Fate::Deleted;
            return Ok(());
        }
        let key = NewKey {
            name: "of a test".to_owned(),
            tenant: None,
            scopes: vec![Scope::Read],
            expires_in: None,
        };
        let made = told(client.create_key(&key).await)?;
        let made = made.map_err(|status| Stop::Wrong(format!("a key: {status}")))?;
        self.add(Thing { secret: made.secret, ..Thing::new(Kind::Key, made.key.id) });
        Ok(())
    }

    async fn make_webhook(&mut self, client: &Client) -> Result<(), Stop> {
        if self.kept(Kind::Webhook).len() >= 3 {
            return Ok(());
        }
        // No server listens there, and none of these jobs ends in this state.
        let url = format!("http://127.0.0.1:9/{}", self.made);
        let webhook = NewWebhook { url, events: vec![WebhookEvent::JobRejected], name: None };
        let made = told(client.create_webhook(&webhook).await)?;
        let made = made.map_err(|status| Stop::Wrong(format!("a webhook: {status}")))?;
        self.add(Thing::new(Kind::Webhook, made.webhook.id));
        Ok(())
    }

    async fn rename(&mut self, client: &Client) -> Result<(), Stop> {
        let kinds = [Kind::Capture, Kind::Environment, Kind::Job, Kind::Model];
        let kind = kinds[self.random.random_range(0..kinds.len())];
        let Some(place) = self.any(kind).filter(|place| !self.things[*place].names.is_empty()) else {
            return Ok(());
        };
        self.made += 1;
        let name = Some(format!("name {}", self.made));
        self.things[place].names.insert(name.clone());
        let id = self.things[place].id.as_str();
        let change = MetadataChange { name: Some(name.clone()), ..MetadataChange::default() };
        let answer = match kind {
            Kind::Capture => client.change_capture(&id.into(), &change).await.map(drop),
            Kind::Environment => client.change_environment(&id.into(), &change).await.map(drop),
            Kind::Model => client.change_model(&id.into(), &change).await.map(drop),
            _ => {
                let change = JobChange { name: Some(name.clone()), ..JobChange::default() };
                client.change_job(&id.into(), &change).await.map(drop)
            }
        };
        told(answer)?.map_err(|status| Stop::Wrong(format!("a name of {kind:?} {id}: {status}")))?;
        self.things[place].names = [name].into();
        Ok(())
    }

    /// Compares all answers with the state of the server. Afterwards the result of unanswered requests is
    /// known as well.
    pub async fn verify(&mut self, client: &Client) -> Result<(), Stop> {
        let maps = told(client.environments().await)?.map_err(|status| Stop::Wrong(status.to_string()))?;
        for place in 0..self.things.len() {
            let thing = &mut self.things[place];
            let id = thing.id.as_str();
            let (is_there, name) = match thing.kind {
                Kind::Capture => {
                    let view = found(client.capture(&id.into()).await)?;
                    (view.is_some(), view.and_then(|view| view.metadata.name))
                }
                Kind::Environment => {
                    let view = maps.uploaded.items.iter().find(|view| view.id.as_str() == id);
                    (view.is_some(), view.and_then(|view| view.metadata.name.clone()))
                }
                Kind::Model => {
                    let view = found(client.model(&id.into()).await)?;
                    if let Some(view) = &view {
                        self.settle_reflectance(place, view)?;
                    }
                    (view.is_some(), view.and_then(|view| view.summary.metadata.name))
                }
                Kind::Upload => {
                    let view = found(client.upload(&id.into()).await)?;
                    let offset =
                        view.as_ref().map_or(thing.offset, |view| usize::try_from(view.offset).unwrap());
                    if offset < thing.offset {
                        return Err(Stop::Wrong(format!("upload {id} is at {offset}, not {}", thing.offset)));
                    }
                    thing.offset = offset;
                    (view.is_some(), None)
                }
                Kind::Export => (self.verify_export(client, place).await?, None),
                Kind::Photographs => (self.verify_photographs(client, place).await?, None),
                Kind::Webhook => (found(client.webhook(&id.into()).await)?.is_some(), None),
                Kind::Key => (self.lets_in(client, place).await?, None),
                Kind::Job => continue,
            };
            let thing = &mut self.things[place];
            thing.settle(is_there).map_err(Stop::Wrong)?;
            if is_there {
                thing.settle_name(name).map_err(Stop::Wrong)?;
            }
        }
        self.verify_jobs(client).await?;
        // Deleted resources are not requested for ever.
        let random = &mut self.random;
        self.things.retain(|thing| thing.fate != Fate::Deleted || random.random_bool(0.5));
        Ok(())
    }

    /// Whether a key is valid.
    async fn lets_in(&self, client: &Client, place: usize) -> Result<bool, Stop> {
        let secret = self.things[place].secret.clone();
        let bearer = Client::new(client.base().as_str(), Some(secret)).unwrap();
        match told(bearer.models().await)? {
            Ok(_) => Ok(true),
            Err(401) => Ok(false),
            Err(status) => Err(Stop::Wrong(format!("a key: {status}"))),
        }
    }

    /// Compares jobs. The jobs of a deleted capture were deleted in the same transaction, except jobs with a
    /// model.
    async fn verify_jobs(&mut self, client: &Client) -> Result<(), Stop> {
        for place in 0..self.things.len() {
            if self.things[place].kind != Kind::Job {
                continue;
            }
            let view = found(client.job(&self.things[place].id.as_str().into()).await)?;
            self.things[place].settle(view.is_some()).map_err(Stop::Wrong)?;
            let Some(view) = view else { continue };
            self.verify_job(place, view)?;
        }
        Ok(())
    }

    fn verify_job(&mut self, place: usize, view: JobView) -> Result<(), Stop> {
        let job = &mut self.things[place];
        job.settle_name(view.metadata.name.clone()).map_err(Stop::Wrong)?;
        let ended_before = job.ended.is_some();
        job.settle_state(view.state).map_err(Stop::Wrong)?;
        let parent = job.parent.clone();
        let is_gone = |thing: &Thing| thing.id == parent && thing.fate == Fate::Deleted;
        if view.state != JobState::Succeeded && self.things.iter().any(is_gone) {
            return Err(Stop::Wrong(format!("job {} was not deleted with capture {parent}", view.id)));
        }
        if let (false, Some(model), None) = (ended_before, view.model, view.model_deleted_at) {
            // The model has the name that the job had at its end, which may differ.
            self.add(Thing { names: BTreeSet::new(), ..Thing::new(Kind::Model, model) });
        }
        Ok(())
    }
}
