//! The lights of frames, and the maps that are decoded already.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use lru::LruCache;

use relume_capture::builtin;
use relume_capture::formats::environment;
use relume_scene::light::map_rows::RENDERED_ROWS;
use relume_scene::{EnvMap, Illumination, Model, RECOVERED_GROUP};

/// Number of decoded maps in memory. A map of [`RENDERED_ROWS`] rows takes 25 MB.
const DECODED_MAPS: NonZeroUsize = NonZeroUsize::new(4).unwrap();

/// The most recently used environment maps by the hash of their files, so that a map is decoded once between its upload and its
/// uses. Clones share them.
#[derive(Debug, Clone)]
pub struct DecodedMaps(Arc<Mutex<LruCache<String, Arc<EnvMap>>>>);

impl Default for DecodedMaps {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(LruCache::new(DECODED_MAPS))))
    }
}

impl DecodedMaps {
    fn get(&self, sha256: &str) -> Option<Arc<EnvMap>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(sha256).cloned()
    }

    /// Keeps the map of the file with this hash, reduced to the size for rendering, and returns it.
    pub fn put(&self, sha256: &str, map: EnvMap) -> Arc<EnvMap> {
        let map = Arc::new(LightSource::downscaled(map));
        self.0.lock().unwrap_or_else(PoisonError::into_inner).put(sha256.to_owned(), map.clone());
        map
    }
}

/// A light to render under.
#[derive(Debug, Clone)]
pub enum LightSource {
    /// A built-in map.
    Builtin(String),
    /// The recovered light of the model, of its first light group.
    Recovered,
    /// The recovered light of a light group of the model, by the name of the group.
    RecoveredGroup(String),
    /// An environment file on this machine, by content hash.
    Stored {
        /// Content hash, the cache key.
        sha256: String,
        /// The file.
        path: PathBuf,
        /// Where its decoded map is kept.
        maps: DecodedMaps,
    },
    /// A map in the request.
    Inline {
        /// Content hash, the cache key.
        sha256: String,
        /// The map.
        map: Arc<EnvMap>,
    },
}

impl LightSource {
    /// Identifies the content of the light: equal keys mean equal light for the same model.
    pub fn key(&self) -> String {
        match self {
            Self::Builtin(name) => format!("builtin:{name}"),
            Self::Recovered => "recovered".to_owned(),
            Self::RecoveredGroup(name) => format!("{RECOVERED_GROUP}{name}"),
            Self::Stored { sha256, .. } | Self::Inline { sha256, .. } => format!("sha256:{sha256}"),
        }
    }

    /// A map with the size limit at which no tier loses accuracy.
    pub fn downscaled(map: EnvMap) -> EnvMap {
        map.at_most_rows(RENDERED_ROWS)
    }

    /// The light for a model.
    ///
    /// # Errors
    /// The reason why the file cannot be read, or why the model has no such light.
    pub fn illumination(&self, model: &Model) -> Result<Illumination, String> {
        match self.map()? {
            Some(map) => Ok(Illumination::from(&*map)),
            None => model.named_recovered_light(&self.key()).unwrap_or_else(|| Ok(model.recovered_light())),
        }
    }

    /// The map; `None` for the recovered light, which depends on the model.
    ///
    /// # Errors
    /// The reason why the file cannot be read.
    pub fn map(&self) -> Result<Option<Arc<EnvMap>>, String> {
        match self {
            Self::Inline { map, .. } => Ok(Some(map.clone())),
            Self::Recovered | Self::RecoveredGroup(_) => Ok(None),
            Self::Builtin(name) => {
                builtin(name).map(|map| Some(Arc::new(map))).ok_or_else(|| "is not a built-in map".to_owned())
            }
            Self::Stored { path, sha256, maps } => {
                if let Some(map) = maps.get(sha256) {
                    return Ok(Some(map));
                }
                let bytes = std::fs::read(path).map_err(|e| e.to_string())?;
                let loaded = environment::decode(&bytes).map_err(|e| e.to_string())?;
                Ok(Some(maps.put(sha256, loaded.map)))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stored_map_is_decoded_once() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("map.hdr");
        std::fs::write(&path, environment::encode_hdr(&EnvMap::constant(8, 4, [0.5; 3])).unwrap()).unwrap();
        let stored = |sha256: &str, maps: &DecodedMaps| LightSource::Stored {
            sha256: sha256.to_owned(),
            path: path.clone(),
            maps: maps.clone(),
        };
        let maps = DecodedMaps::default();
        let first = stored("a", &maps).map().unwrap().unwrap();
        std::fs::write(&path, "damaged").unwrap();
        assert!(Arc::ptr_eq(&stored("a", &maps).map().unwrap().unwrap(), &first));
        assert!(stored("b", &maps).map().is_err(), "the control: another file is decoded");
        maps.put("b", EnvMap::constant(8, 4, [1.0; 3]));
        assert_eq!(*stored("b", &maps).map().unwrap().unwrap(), EnvMap::constant(8, 4, [1.0; 3]));
    }
}
