//! Requests about photographs without poses, whose poses the server finds in the background.

use relume_api::captures::{CaptureState, CaptureSummary};
use relume_capture::formats::image_file;
use relume_client::Client;

use super::{Requests, Stop, done_or_in_the_way, found, told};
use crate::kills::known::{Fate, Kind, Thing};
use crate::poses::PHOTOGRAPHS;
use crate::service_support::zip_of;

/// Maximum number of sets of photographs of a client.
const MOST_SETS: usize = 3;
/// The code of a capture during whose validation several servers ended, which kills cause.
const INTERRUPTED: &str = "validation_interrupted";
/// The code of a capture whose validation ended because its deletion was requested.
const CANCELLED: &str = "cancelled";

/// Photograph `i` of a set, 8x6 pixels. No two photographs of all clients are equal, because equal photographs are one capture.
fn photograph(client: u64, set: u64, i: usize) -> Vec<u8> {
    let [high, low] = u16::try_from(set).unwrap().to_be_bytes();
    let number = [high, low, u8::try_from(client).unwrap(), u8::try_from(i).unwrap()];
    let pixels: Vec<[u8; 3]> = (0..48_u8).map(|p| [number[usize::from(p) % 4], p, 200]).collect();
    image_file::encode_png(8, 6, &pixels).unwrap()
}

impl Requests {
    /// Uploads photographs without poses, or deletes some.
    pub(super) async fn upload_or_delete_photographs(&mut self, client: &Client) -> Result<(), Stop> {
        let kept = self.kept(Kind::Photographs).len();
        if let Some(place) = self.any(Kind::Photographs).filter(|_| kept >= MOST_SETS) {
            self.things[place].fate = Fate::Either;
            self.things[place].stopping = true;
            let id = self.things[place].id.as_str().into();
            let deleted = done_or_in_the_way(told(client.delete_capture(&id, false).await))?;
            self.things[place].fate = if deleted.is_some() { Fate::Deleted } else { Fate::Kept };
            return Ok(());
        }
        self.made += 1;
        let photographs: Vec<_> =
            (0..PHOTOGRAPHS).map(|i| (format!("{i}.png"), photograph(self.number, self.made, i))).collect();
        let capture = told(client.upload_capture_bytes(zip_of(&photographs)).await)?;
        let capture = capture.map_err(|status| Stop::Wrong(format!("photographs: {status}")))?;
        self.add(Thing::new(Kind::Photographs, capture.id));
        Ok(())
    }

    /// Compares photographs. A capture whose validation has ended stays as it is: complete, or
    /// refused because kills interrupted it or its deletion was requested.
    pub(super) async fn verify_photographs(&mut self, client: &Client, place: usize) -> Result<bool, Stop> {
        let id = self.things[place].id.as_str().into();
        let view: Option<CaptureSummary> = found(client.capture(&id).await)?;
        let Some(view) = view else { return Ok(false) };
        let wrong = |what: &str| Err(Stop::Wrong(format!("photographs {id}: {what}: {view:?}")));
        let photographs = view.report.train_images + view.report.test_images;
        let code =
            view.problem.as_ref().and_then(|problem| problem.content.as_ref()).map(|content| &content.code);
        let stopping = self.things[place].stopping;
        let may_end_with = |code: &str| code == INTERRUPTED || (stopping && code == CANCELLED);
        match view.state {
            CaptureState::Ready if photographs != PHOTOGRAPHS || view.report.layout != "colmap" => {
                return wrong("incomplete");
            }
            CaptureState::Invalid if !code.is_some_and(|code| may_end_with(code)) => return wrong("refused"),
            _ => {}
        }
        let known = &mut self.things[place].validation;
        self.posed += u64::from(known.is_none() && view.state == CaptureState::Ready);
        if known.is_some_and(|ended| ended != view.state) {
            return wrong("the validation had ended otherwise");
        }
        *known = Some(view.state).filter(|state| *state != CaptureState::Validating);
        Ok(true)
    }

    /// Whether the server still validates a capture.
    pub async fn any_validation(client: &Client) -> bool {
        let captures = client.captures().await.unwrap().items;
        captures.iter().any(|capture| capture.state == CaptureState::Validating)
    }
}
