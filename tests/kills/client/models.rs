//! Requests about models: exports and calibrations.

use rand::RngExt;
use relume_api::calibration::{NewCalibration, Patch};
use relume_api::exports::{ExportState, ExportView, NewExport, SplatsExport, SplatsKind};
use relume_api::models::ModelView;
use relume_client::Client;

use super::{Requests, Stop, done_or_in_the_way, found, told};
use crate::kills::known::{Fate, Kind, Thing};

/// Maximum number of exports of a client.
const MOST_EXPORTS: usize = 3;

impl Requests {
    /// Creates an export of a model, or deletes one.
    pub(super) async fn make_or_delete_export(&mut self, client: &Client) -> Result<(), Stop> {
        let kept = self.kept(Kind::Export).len();
        if let Some(place) =
            self.any(Kind::Export).filter(|_| kept >= MOST_EXPORTS || self.answered.is_multiple_of(3))
        {
            // A queued or running export is cancelled and stays; one that has ended is deleted.
            self.things[place].fate = Fate::Either;
            let id = self.things[place].id.as_str().into();
            return done_or_in_the_way(told(client.delete_export(&id).await)).map(drop);
        }
        let Some(model) = self.any(Kind::Model).map(|place| self.things[place].id.clone()) else {
            return Ok(());
        };
        let kind = [SplatsKind::Ply, SplatsKind::Usdz][self.random.random_range(0..2)];
        let export = NewExport::Splats(SplatsExport::of(kind));
        let made = told(client.create_export(&model.as_str().into(), &export, None).await)?;
        let made = made.map_err(|status| Stop::Wrong(format!("an export: {status}")))?;
        self.add(Thing { parent: model, ..Thing::new(Kind::Export, made.id) });
        Ok(())
    }

    /// Calibrates a model or undoes its calibrations.
    pub(super) async fn calibrate_or_undo(&mut self, client: &Client) -> Result<(), Stop> {
        let Some(place) = self.any(Kind::Model) else { return Ok(()) };
        let id = self.things[place].id.as_str().into();
        let percent = [None, Some(20), Some(50)][self.random.random_range(0..3)];
        self.things[place].reflectances.insert(percent);
        let answer = match percent {
            None => client.undo_calibration(&id).await,
            Some(percent) => {
                let patch = Patch { photo: "train/r_0.png".to_owned(), x: 6, y: 6, width: 4, height: 4 };
                let reflectance = [percent as f32 / 100.0; 3];
                client.calibrate(&id, &NewCalibration { patch, reflectance }).await
            }
        };
        match told(answer)? {
            Ok(view) => {
                self.calibrated += 1;
                self.settle_reflectance(place, &view)
            }
            // A model of few steps may not cover the patch, or cannot be scaled that far; its capture may be deleted.
            Err(409 | 410 | 422) => Ok(()),
            Err(status) => Err(Stop::Wrong(format!("a calibration: {status}"))),
        }
    }

    /// Records the calibration of a model; an error if it is none of those that were requested.
    pub(super) fn settle_reflectance(&mut self, place: usize, view: &ModelView) -> Result<(), Stop> {
        let percent = view.calibration.as_ref().map(|found| (found.reflectance[0] * 100.0).round() as i32);
        let known = &mut self.things[place].reflectances;
        if !known.contains(&percent) {
            let id = &view.summary.id;
            return Err(Stop::Wrong(format!(
                "model {id} has the reflectance {percent:?}, not one of {known:?}"
            )));
        }
        *known = [percent].into();
        Ok(())
    }

    /// Compares an export. Its file is complete if there is one.
    pub(super) async fn verify_export(&mut self, client: &Client, place: usize) -> Result<bool, Stop> {
        let id = self.things[place].id.as_str().into();
        let view: Option<ExportView> = found(client.export(&id).await)?;
        let Some(view) = view else { return Ok(false) };
        if let (ExportState::Succeeded, Some(file)) = (view.state, &view.file) {
            let Some(bytes) = found(client.export_file(&id).await)? else {
                return Err(Stop::Wrong(format!("export {id} has no file")));
            };
            if i64::try_from(bytes.len()) != Ok(file.bytes) {
                return Err(Stop::Wrong(format!("the file of export {id} has {} bytes", bytes.len())));
            }
        }
        Ok(true)
    }

    /// A model was deleted with its exports.
    pub(super) fn forget_exports_of(&mut self, model: &str) {
        let of_it = |thing: &&mut Thing| thing.kind == Kind::Export && thing.parent == model;
        self.things.iter_mut().filter(of_it).for_each(|export| export.fate = Fate::Either);
    }
}
