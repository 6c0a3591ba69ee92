//! LLFF: `poses_bounds.npy` beside `images/`, one row for each photograph in the order of their names.

use glam::{DMat3, DMat4, DVec3};

use crate::distortion::Distortion;
use crate::lens::Lens;
use crate::photo_finder::PhotoFinder;
use crate::photos::{PhotoEntry, Split};
use crate::selection::PHOTOGRAPHS;
use crate::truth::TruthFiles;
use crate::upright::{StatedUp, upright};
use crate::{CaptureError, CaptureFiles, Up, WorldUp, layout, masks};

/// The file that marks this layout.
pub(super) const MARKER: &str = "poses_bounds.npy";
/// Folders that may hold the photographs; the first that has any is used. Poses are scaled to the size of the images.
const IMAGE_FOLDERS: [&str; 4] = ["images", "images_2", "images_4", "images_8"];
/// Values in a row: a 3 x 5 matrix, nearest and farthest depth.
const COLUMNS: usize = 17;

/// The photographs, in a world rotated so that up is +Z. This layout has no lens distortion.
///
/// # Errors
/// Names the row at fault, or says that the numbers of poses and photographs differ.
pub(super) fn read(
    source: &CaptureFiles,
    marker: &str,
    up: Up,
    warnings: &mut Vec<String>,
) -> Result<(Vec<PhotoEntry>, WorldUp), CaptureError> {
    let file_error = |reason: String| CaptureError::File { file: marker.to_owned(), reason };
    let rows = rows(&source.read(marker)?).map_err(file_error)?;
    let images = images(source, &layout::folder_of(marker));
    if images.len() != rows.len() {
        let reason = format!("has {} poses for {} images in images/", rows.len(), images.len());
        return Err(file_error(reason));
    }
    PhotoFinder::new(source, Vec::new()).finish(marker, images.len(), warnings)?;
    let poses =
        rows.iter().enumerate().map(|(i, row)| pose(marker, i, row)).collect::<Result<Vec<_>, _>>()?;
    let world = upright(&poses, &[], up, StatedUp::No("LLFF"), warnings);
    let turn = DMat4::from_quat(world.rotation());
    let photo = |(i, ((image, row), pose)): (usize, ((String, &[f64; COLUMNS]), DMat4))| {
        let [height, width, focal] = [row[4], row[9], row[14]];
        PhotoEntry {
            mask: None,
            image,
            pose: turn * pose,
            lens: Lens {
                size: Some((width, height)),
                focal: [Some(focal); 2],
                angle: [None; 2],
                centre: [None; 2],
                distortion: Distortion::None,
            },
            light_rotation_deg: 0.0,
            light_group: None,
            stated_in: marker.to_owned(),
            field: format!("[{i}]"),
            split: Split::Train,
            truth: TruthFiles::default(),
        }
    };
    Ok((images.into_iter().zip(&rows).zip(poses).enumerate().map(photo).collect(), world))
}

/// The photographs in the folders of `root`, by name.
fn images(source: &CaptureFiles, root: &str) -> Vec<String> {
    let is_photo = |path: &&str| {
        let lower = path.to_ascii_lowercase();
        lower.rsplit_once('.').is_some_and(|(_, ending)| PHOTOGRAPHS.contains(&ending))
    };
    let of = |folder: &&str| {
        let folder = format!("{root}{folder}");
        let photos = masks::separate(source.paths_under(&folder).filter(is_photo));
        photos.into_iter().map(str::to_owned).collect::<Vec<_>>()
    };
    IMAGE_FOLDERS.iter().map(of).find(|images| !images.is_empty()).unwrap_or_default()
}

/// Camera-to-world, OpenGL axes. A row has the camera's down, right and backwards axes and its centre as columns.
fn pose(marker: &str, index: usize, row: &[f64; COLUMNS]) -> Result<DMat4, CaptureError> {
    let column = |k: usize| DVec3::new(row[k], row[5 + k], row[10 + k]);
    let [down, right, back, centre] = [0, 1, 2, 3].map(column);
    let axes = DMat3::from_cols(right, -down, back);
    if !(axes.is_finite() && centre.is_finite() && axes.determinant() > 1e-9) {
        return Err(CaptureError::at_field(marker, format!("[{index}]"), "is not a valid pose"));
    }
    let mut pose = DMat4::from_mat3(axes);
    pose.w_axis = centre.extend(1.0);
    Ok(pose)
}

/// The rows of an array of 17 columns of little-endian floats in NumPy's file format.
fn rows(bytes: &[u8]) -> Result<Vec<[f64; COLUMNS]>, String> {
    let cut = || "is truncated".to_owned();
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or("is not an .npy file")?;
    let (&[major, _], rest) = rest.split_first_chunk::<2>().ok_or_else(cut)?;
    let (length, rest) = match major {
        1 => {
            let (length, rest) = rest.split_first_chunk::<2>().ok_or_else(cut)?;
            (usize::from(u16::from_le_bytes(*length)), rest)
        }
        _ => {
            let (length, rest) = rest.split_first_chunk::<4>().ok_or_else(cut)?;
            (u32::from_le_bytes(*length) as usize, rest)
        }
    };
    let (header, data) = rest.split_at_checked(length).ok_or_else(cut)?;
    let header = String::from_utf8_lossy(header).replace(' ', "");
    let is_double = header.contains("'descr':'<f8'");
    if !(is_double || header.contains("'descr':'<f4'")) || !header.contains("'fortran_order':False") {
        return Err(
            "must contain little-endian 32-bit or 64-bit floats in row-major order; store it again with \
                    np.ascontiguousarray(poses, dtype='<f8')"
                .to_owned(),
        );
    }
    let shape = header.split_once("'shape':(").and_then(|(_, rest)| rest.split_once(')'));
    let shape: Vec<&str> = shape.map(|(shape, _)| shape.split(',').collect()).unwrap_or_default();
    let [count, "17"] = shape[..] else {
        return Err(format!("must have 17 columns; its shape is ({})", shape.join(",")));
    };
    let values = if is_double {
        floats(data, f64::from_le_bytes)
    } else {
        floats(data, |v| f32::from_le_bytes(v).into())
    };
    let stated = count.parse().ok().and_then(|n: usize| n.checked_mul(COLUMNS));
    let values = values.filter(|values| Some(values.len()) == stated);
    let values = values.ok_or("contains another number of values than its header states")?;
    Ok(values.as_chunks::<COLUMNS>().0.to_vec())
}

/// The values of an array; `None` if its last value is incomplete.
fn floats<const N: usize>(data: &[u8], value: impl Fn([u8; N]) -> f64) -> Option<Vec<f64>> {
    let (values, rest) = data.as_chunks::<N>();
    rest.is_empty().then(|| values.iter().map(|bytes| value(*bytes)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::image_file::encode_png;
    use crate::{ImportOptions, import};
    use relume_scene::Camera;

    fn npy(shape: &str, values: &[f64]) -> Vec<u8> {
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({shape}), }}\n");
        let mut out = b"\x93NUMPY\x01\x00".to_vec();
        out.extend((header.len() as u16).to_le_bytes());
        out.extend(header.bytes());
        out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        out
    }

    fn camera(i: u32) -> Camera {
        let eye = DVec3::new(3.0, f64::from(i) - 1.0, 1.0);
        Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, (8, 6)).unwrap()
    }

    fn row(camera: &Camera) -> Vec<f64> {
        let m = camera.to_opengl();
        let columns = [-m.y_axis, m.x_axis, m.z_axis, m.w_axis];
        let size = [6.0, 8.0, camera.fy];
        let rows = (0..3).flat_map(|r| columns.iter().map(|c| c[r]).chain([size[r]]).collect::<Vec<_>>());
        rows.chain([1.0, 9.0]).collect()
    }

    #[test]
    fn llff_set_is_imported_with_its_cameras() {
        let folder = tempfile::TempDir::new().unwrap();
        let images = folder.path().join("images");
        std::fs::create_dir(&images).unwrap();
        for i in 0..3 {
            let png = encode_png(8, 6, &[[9u8 * i, 0, 0]; 48]).unwrap();
            std::fs::write(images.join(format!("{i}.png")), png).unwrap();
        }
        std::fs::write(images.join("2_mask.png"), encode_png(8, 6, &[[255u8]; 48]).unwrap()).unwrap();
        let cameras = [0, 1, 2].map(camera);
        let values: Vec<f64> = cameras.iter().flat_map(row).collect();
        std::fs::write(folder.path().join(MARKER), npy("3, 17", &values)).unwrap();
        let capture = import(folder.path(), &ImportOptions::default()).unwrap();
        assert_eq!((capture.layout.as_str(), capture.train.len(), capture.test.len()), ("llff", 2, 1));
        // The up direction of the cameras is rotated to +Z, so the test compares relative poses.
        for (view, camera) in capture.train.iter().zip(&cameras[1..]) {
            let seen = view.camera.forward().dot(capture.test[0].camera.forward());
            let stated = camera.forward().dot(cameras[0].forward());
            assert!((seen - stated).abs() < 1e-9, "{}", view.name);
            assert!((view.camera.fx - camera.fx).abs() < 1e-9);
        }
        std::fs::write(folder.path().join(MARKER), npy("2, 17", &values[..34])).unwrap();
        let error = import(folder.path(), &ImportOptions::default()).unwrap_err().to_string();
        assert!(error.contains("2 poses for 3 images"), "{error}");
    }

    #[test]
    fn arrays_of_another_type_or_shape_are_refused() {
        let good = npy("1, 17", &[0.5; 17]);
        assert_eq!(rows(&good).unwrap(), [[0.5; 17]]);
        assert!(rows(&good[..good.len() - 1]).is_err() && rows(&good[..9]).is_err() && rows(b"PK").is_err());
        assert!(rows(&npy("1, 16", &[0.5; 16])).unwrap_err().contains("17"));
        assert!(rows(&npy("9, 17", &[0.5; 17])).is_err());
        let relabel = |array: &[u8], kind: &[u8; 3]| {
            let at = array.windows(3).position(|part| part == b"<f8").unwrap();
            [&array[..at], kind, &array[at + 3..]].concat()
        };
        let relabelled = |kind: &[u8; 3]| relabel(&good, kind);
        assert!(
            rows(&relabelled(b"<f4")).unwrap_err().contains("number of values"),
            "half as many values as 64-bit floats"
        );
        assert!(rows(&relabelled(b">f8")).unwrap_err().contains("ascontiguousarray"));
        let header = relabel(&npy("1, 17", &[]), b"<f4");
        let values = [0.25f32; 17].iter().flat_map(|v| v.to_le_bytes());
        assert_eq!(rows(&header.into_iter().chain(values).collect::<Vec<_>>()).unwrap(), [[0.25; 17]]);
        assert!(pose(MARKER, 0, &[0.0; 17]).is_err() && pose(MARKER, 0, &[f64::NAN; 17]).is_err());
    }
}
