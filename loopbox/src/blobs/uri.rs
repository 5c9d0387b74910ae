//! Places of objects as people name them: a folder, or a URI.

use super::{Blobs, FolderBlobs};
use anyhow::{Result, anyhow, bail};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A place of objects or of a map, as it is named.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place<'a> {
    /// On this machine.
    Local(&'a Path),
    /// In a bucket: the URI.
    Bucket(&'a str),
}

impl<'a> Place<'a> {
    /// The place of that name: a path, `file:///PATH`, or a URI that begins with `s3://`, `gs://` or `az://`.
    ///
    /// # Errors
    /// When it is a URI of another kind.
    pub fn of(name: &'a Path) -> Result<Self> {
        let Some((text, (scheme, rest))) =
            name.to_str().and_then(|text| Some((text, text.split_once("://")?)))
        else {
            return Ok(Self::Local(name));
        };
        match scheme {
            "file" if rest.starts_with('/') => Ok(Self::Local(Path::new(rest))),
            "s3" | "gs" | "az" if !rest.starts_with('/') && !rest.is_empty() => Ok(Self::Bucket(text)),
            _ if scheme.chars().all(|c| c.is_ascii_alphanumeric()) => bail!(
                "{text}: is no place that loopbox knows\nhint: name a folder, file:///PATH, s3://BUCKET/PREFIX, gs://BUCKET/PREFIX \
                 or az://CONTAINER/PREFIX"
            ),
            _ => Ok(Self::Local(name)),
        }
    }
}

/// The objects at a place; a folder is made if it is not there.
///
/// # Errors
/// When the place cannot be used, or is a bucket and the program was built without these.
pub fn open(name: &Path) -> Result<Arc<dyn Blobs>> {
    match Place::of(name)? {
        Place::Local(folder) => Ok(Arc::new(FolderBlobs::at(folder)?)),
        #[cfg(feature = "object-store")]
        Place::Bucket(uri) => Ok(Arc::new(super::BucketBlobs::at(uri)?)),
        #[cfg(not(feature = "object-store"))]
        Place::Bucket(uri) => without_buckets(uri),
    }
}

/// The files of maps, each given as a path or a URI: those in buckets are copied once into the user's cache, and found there by what the
/// server says of their version. `s3://BUCKET/PREFIX/*` stands for all maps under a prefix. `report` gets what is copied.
///
/// # Errors
/// When there is no map, the bucket cannot be read, or the program was built without buckets.
pub fn local_maps(maps: &[PathBuf], report: &dyn Fn(&str)) -> Result<Vec<LocalMap>> {
    #[cfg(feature = "object-store")]
    let mut copies = super::copies::Copies::new(report);
    #[cfg(not(feature = "object-store"))]
    let _ = report;
    let mut all = Vec::new();
    for given in maps {
        match Place::of(given)? {
            Place::Local(local) => all.push(LocalMap { given: given.clone(), local: local.to_owned() }),
            #[cfg(feature = "object-store")]
            Place::Bucket(uri) => all.extend(copies.of(uri)?),
            #[cfg(not(feature = "object-store"))]
            Place::Bucket(uri) => return without_buckets(uri),
        }
    }
    Ok(all)
}

/// A map as it is called, and where it is on this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LocalMap {
    /// As it was given, or would be where a prefix was.
    pub given: PathBuf,
    /// Its file or folder.
    pub local: PathBuf,
}

/// The files alone.
///
/// # Errors
/// As [`local_maps`].
pub fn local_files(maps: &[PathBuf], report: &dyn Fn(&str)) -> Result<Vec<PathBuf>> {
    Ok(local_maps(maps, report)?.into_iter().map(|map| map.local).collect())
}

/// The files of two maps.
///
/// # Errors
/// As [`local_maps`], and when they are not two: a name may stand for several.
pub fn local_pair(maps: &[PathBuf; 2], report: &dyn Fn(&str)) -> Result<[PathBuf; 2]> {
    let files = local_files(maps, report)?;
    files
        .try_into()
        .map_err(|files: Vec<_>| anyhow!("a verdict is on two maps, and these are {}", files.len()))
}

/// The recordings that these names stand for: of `s3://BUCKET/PREFIX/*` all that lies right under the prefix, an object or a folder each.
///
/// # Errors
/// When a bucket cannot be read, nothing lies there, or the program was built without buckets.
pub fn recordings_at(names: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for name in names {
        match Place::of(name) {
            #[cfg(feature = "object-store")]
            Ok(Place::Bucket(uri)) => all.extend(super::recordings::listed(uri)?),
            #[cfg(not(feature = "object-store"))]
            Ok(Place::Bucket(uri)) => return without_buckets(uri),
            _ => all.push(name.clone()),
        }
    }
    Ok(all)
}

/// The file or folder of a recording, given as a path or a URI: one in a bucket is copied once into the user's cache, an object or all
/// objects under that name. `report` gets what is copied.
///
/// # Errors
/// When there is none in the bucket, it cannot be copied, or the program was built without buckets.
pub fn local_recording(name: &Path, report: &dyn Fn(&str)) -> Result<PathBuf> {
    #[cfg(not(feature = "object-store"))]
    let _ = report;
    match Place::of(name) {
        #[cfg(feature = "object-store")]
        Ok(Place::Bucket(uri)) => super::recordings::local(uri, report),
        #[cfg(not(feature = "object-store"))]
        Ok(Place::Bucket(uri)) => without_buckets(uri),
        Ok(Place::Local(path)) => Ok(path.to_owned()),
        // Who opens recordings says what to do with other addresses.
        Err(_) => Ok(name.to_owned()),
    }
}

#[cfg(not(feature = "object-store"))]
fn without_buckets<T>(uri: &str) -> Result<T> {
    bail!(
        "{uri}: this loopbox was built without buckets\nhint: build it with the feature object-store (cargo install --locked --path \
         agent-bin --features object-store), or name a folder that is mounted there"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_paths_or_uris() {
        let of = |name: &'static str| Place::of(Path::new(name));
        for path in ["out/a", "/out", "a:b", "odd name://x", "s3:/bucket"] {
            assert_eq!(of(path).unwrap(), Place::Local(Path::new(path)));
        }
        assert_eq!(of("file:///out/a").unwrap(), Place::Local(Path::new("/out/a")));
        for uri in ["s3://bucket", "gs://bucket/a", "az://box/a/*"] {
            assert_eq!(of(uri).unwrap(), Place::Bucket(uri));
        }
        for other in ["http://host/a", "s3:///a", "s3://", "file://out", "S3://bucket"] {
            let refused = of(other).unwrap_err().to_string();
            assert!(refused.starts_with(other) && refused.contains("hint: name a folder"), "{refused}");
        }
    }

    #[cfg(not(feature = "object-store"))]
    #[test]
    fn a_build_without_buckets_says_so() {
        let name = Path::new("s3://bucket/a");
        let names = [name.to_owned()];
        for refused in [
            open(name).map(drop),
            local_files(&names, &|_| {}).map(drop),
            local_recording(name, &|_| {}).map(drop),
            recordings_at(&names).map(drop),
        ] {
            let refused = refused.unwrap_err().to_string();
            assert!(
                refused.starts_with("s3://bucket/a: ") && refused.contains("--features object-store"),
                "{refused}"
            );
        }
    }
}
