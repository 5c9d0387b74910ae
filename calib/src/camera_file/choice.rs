//! Which camera of a file with several took the images.

use crate::CalibError;
use std::path::{Component, Path, PathBuf};

/// What is known of the camera that took the images, by which it is found in a file of several.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CameraHint {
    /// What the user calls it.
    pub name: Option<String>,
    /// The topic that its images are on.
    pub topic: Option<String>,
    /// The folder that they lie in.
    pub folder: Option<PathBuf>,
    /// Width and height of the images, pixels, for files that do not say them.
    pub size: Option<(usize, usize)>,
}

/// What a file says of which camera one of its is.
#[derive(Clone, Debug, Default)]
pub(crate) struct Named {
    /// What it may be called, the file's own name for it first.
    pub names: Vec<String>,
    /// The topic of its images.
    pub topic: Option<String>,
}

impl Named {
    /// A camera with this name alone.
    pub fn of(name: String) -> Self {
        Self { names: vec![name], topic: None }
    }

    /// A camera by its place in a list, which files and folders of several cameras count by.
    pub fn numbered(label: Option<String>, index: usize) -> Self {
        let usual = ["cam", "camera", "camera_", "image_"].map(|name| format!("{name}{index}"));
        Self { names: label.into_iter().chain(usual).collect(), topic: None }
    }

    /// One of the two of a stereo rig, under the file's name for it.
    pub fn side(name: &str, is_right: bool) -> Self {
        let side = if is_right { "right" } else { "left" };
        let names = [name.to_owned(), side.to_owned()].into_iter();
        Self { names: names.chain(Self::numbered(None, usize::from(is_right)).names).collect(), topic: None }
    }
}

/// The index of the camera that took the images.
///
/// # Errors
/// When there are several and `hint` does not tell, or names none.
pub(crate) fn choose(file: &str, cameras: &[Named], hint: &CameraHint) -> Result<usize, CalibError> {
    let of_names = |wanted: &str| {
        cameras.iter().position(|camera| camera.names.iter().any(|name| name.eq_ignore_ascii_case(wanted)))
    };
    let refuse = || {
        let names: Vec<String> = cameras.iter().map(described).collect();
        let first = cameras.first().and_then(|camera| camera.names.first()).map_or("cam0", String::as_str);
        Err(CalibError::WhichCamera {
            file: file.into(),
            names: names.join(", "),
            example: format!("{file}:{first}"),
        })
    };
    if let Some(name) = &hint.name {
        return of_names(name).map_or_else(refuse, Ok);
    }
    if cameras.len() < 2 {
        return Ok(0);
    }
    let is_topic = |camera: &Named, topic: &str| {
        camera.topic.as_deref().is_some_and(|own| of_transport(own) == of_transport(topic))
    };
    if let Some(topic) = &hint.topic {
        if let Some(found) = cameras.iter().position(|camera| is_topic(camera, topic)) {
            return Ok(found);
        }
        if let Some(found) = of_transport(topic).rsplit('/').find_map(of_names) {
            return Ok(found);
        }
    }
    let folders = hint.folder.as_deref().map(Path::components);
    let mut names = folders.into_iter().flatten().rev().filter_map(|part| match part {
        Component::Normal(name) => name.to_str(),
        _ => None,
    });
    names.find_map(of_names).map_or_else(refuse, Ok)
}

/// A topic without what says how its images are packed, and without the slash before it.
fn of_transport(topic: &str) -> &str {
    let topic = topic.trim_start_matches('/');
    ["compressed", "theora", "ffmpeg", "compressedDepth"]
        .iter()
        .find_map(|transport| topic.strip_suffix(transport)?.strip_suffix('/'))
        .unwrap_or(topic)
}

fn described(camera: &Named) -> String {
    let name = camera.names.first().cloned().unwrap_or_default();
    camera.topic.as_ref().map_or(name.clone(), |topic| format!("{name} of {topic}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> [Named; 2] {
        [0, 1].map(|index| Named {
            topic: Some(format!("/rig/{}/image_raw", ["a", "b"][index])),
            ..Named::numbered(None, index)
        })
    }

    fn chosen(hint: &CameraHint) -> Result<usize, String> {
        choose("chain.yaml", &rig(), hint).map_err(|error| error.to_string())
    }

    #[test]
    fn the_camera_is_recognised_by_name_topic_or_folder() {
        let topic = |topic: &str| CameraHint { topic: Some(topic.into()), ..CameraHint::default() };
        let folder = |folder: &str| CameraHint { folder: Some(folder.into()), ..CameraHint::default() };
        assert_eq!(chosen(&topic("/rig/b/image_raw/compressed")), Ok(1));
        assert_eq!(chosen(&topic("rig/a/image_raw")), Ok(0));
        assert_eq!(chosen(&topic("/bag/cam1/image")), Ok(1));
        assert_eq!(chosen(&folder("/data/cam0/room/mav0/cam1/data")), Ok(1));
        assert_eq!(chosen(&CameraHint { name: Some("cam1".into()), ..folder("/cam0") }), Ok(1));
        for hint in [CameraHint::default(), topic("/front/image"), folder("/data/images")] {
            let refusal = chosen(&hint).unwrap_err();
            for word in ["cam0 of /rig/a/image_raw", "cam1 of /rig/b/image_raw", "chain.yaml:cam0"] {
                assert!(refusal.contains(word), "{refusal}");
            }
        }
        assert!(chosen(&CameraHint { name: Some("cam7".into()), ..CameraHint::default() }).is_err());
        assert_eq!(choose("one.yaml", &rig()[..1], &CameraHint::default()).ok(), Some(0));
    }

    #[test]
    fn sides_are_recognised_by_folders_of_stereo_recordings() {
        let sides = [Named::side("LEFT", false), Named::side("RIGHT", true)];
        for (folder, expected) in
            [("mav0/cam1/data", 1), ("seq/image_0", 0), ("bag/right", 1), ("x/left/y", 0)]
        {
            let hint = CameraHint { folder: Some(folder.into()), ..CameraHint::default() };
            assert_eq!(choose("s.yaml", &sides, &hint).ok(), Some(expected), "{folder}");
        }
    }
}
