//! Writes contact sheets.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::cli::error::CommandResult;
use crate::cli::output;
use relume_train::eval::{Sheet, SheetFormat};

/// The format of a sheet by the extension of its file.
pub(super) fn sheet_format(file: &Path) -> Result<SheetFormat, String> {
    let extension = file.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match extension.as_str() {
        "png" => Ok(SheetFormat::Png),
        "jpg" | "jpeg" => Ok(SheetFormat::Jpeg),
        _ => Err(format!("{}: a contact sheet must end in .png or .jpg", file.display())),
    }
}

/// The contact sheet beside a model: `thing.sheet.png` for `thing.safetensors`, `thing.model` and `thing`.
pub(super) fn sheet_beside(model: &Path) -> PathBuf {
    let is_of_models = |extension: &OsStr| extension == "safetensors" || extension == "model";
    let mut name = match model.extension().is_some_and(is_of_models) {
        true => model.file_stem().unwrap_or_default().to_owned(),
        false => model.file_name().unwrap_or_default().to_owned(),
    };
    name.push(".sheet.png");
    model.with_file_name(name)
}

/// Writes a sheet in the format of its file's extension.
pub(super) fn write_sheet(file: &Path, sheet: &Sheet) -> CommandResult {
    Ok(output::write_named(file, &sheet.encode(sheet_format(file)?)?)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sheet_has_the_name_of_its_model() {
        for (model, sheet) in [
            ("a/thing.safetensors", "a/thing.sheet.png"),
            ("thing.model", "thing.sheet.png"),
            ("thing", "thing.sheet.png"),
            ("thing.v2", "thing.v2.sheet.png"),
        ] {
            assert_eq!(sheet_beside(Path::new(model)), Path::new(sheet));
        }
    }

    #[test]
    fn sheet_format_follows_the_extension_and_others_are_refused() {
        let format = |name: &str| sheet_format(Path::new(name));
        assert_eq!([format("a/b.PNG"), format("b.sheet.png")], [Ok(SheetFormat::Png), Ok(SheetFormat::Png)]);
        assert_eq!([format("b.jpg"), format("b.jpeg")], [Ok(SheetFormat::Jpeg), Ok(SheetFormat::Jpeg)]);
        for wrong in ["b", "b.gif", "png"] {
            assert!(format(wrong).is_err_and(|error| error.starts_with(wrong)), "{wrong}");
        }
    }
}
