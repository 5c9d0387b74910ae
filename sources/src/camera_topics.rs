//! Which calibration topic of a recording is that of an image topic.
//!
//! ROS puts a camera's images and its `camera_info` into one namespace (REP 104, `image_transport`'s
//! `getCameraInfoTopic`); other recordings name both after the camera. If neither gives an answer, loopbox does not
//! guess.

/// The result of the comparison of topic names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Match {
    /// This one is the images'.
    Found(String),
    /// There is none: these are other cameras'.
    Others(Vec<String>),
    /// Some may be, and the names do not decide which.
    Unclear(Vec<String>),
}

impl Match {
    /// The topic that is the images'.
    pub fn found(&self) -> Option<String> {
        match self {
            Self::Found(name) => Some(name.clone()),
            Self::Others(_) | Self::Unclear(_) => None,
        }
    }
}

/// Words that topics of all cameras have.
const COMMON: [&str; 22] = [
    "image",
    "images",
    "raw",
    "color",
    "colour",
    "rgb8",
    "gray",
    "grey",
    "mono",
    "rect",
    "rectified",
    "undistorted",
    "camera",
    "cam",
    "info",
    "calibration",
    "calib",
    "intrinsics",
    "compressed",
    "theora",
    "data",
    "msg",
];
/// Last parts of topics that say how images are packed (`image_transport`).
const TRANSPORTS: [&str; 5] = ["compressed", "theora", "ffmpeg", "zstd", "compressedDepth"];

/// Whether the images of a topic are undistorted already, by its name: `image_rect`, `image_rect_color`
/// (`image_proc`), `image_rect_raw`, `image_undistorted`.
pub fn is_rectified(images: &str) -> bool {
    let says = |word: &str| {
        ["rect", "rectified", "undistorted", "undist"].iter().any(|known| word.eq_ignore_ascii_case(known))
    };
    let (space, name) = split(untransported(images));
    // A robot may be called `rect_robot`.
    name.split('_').any(says) || space.split('/').any(says)
}

/// The one of `calibrations` that is the camera's on `images`; `all` are the topics with images.
pub fn calibration_of(images: &str, all: &[&str], calibrations: &[&str]) -> Match {
    if let Some(found) = by_name(images, calibrations) {
        return Match::Found(found.to_owned());
    }
    let claimed = |calibration: &&&str| {
        all.iter().any(|other| !is_same(other, images) && by_name(other, calibrations) == Some(**calibration))
    };
    let owned = |names: Vec<&&str>| names.into_iter().map(|name| (*name).to_owned()).collect();
    let (others, left): (Vec<&&str>, Vec<&&str>) = calibrations.iter().partition(claimed);
    let alone = all.iter().all(|other| is_same(other, images));
    match left[..] {
        [] => Match::Others(owned(others)),
        [one] if alone && !are_distinct(one, images) => Match::Found((*one).to_owned()),
        [one] if is_above(one, images, all) => Match::Found((*one).to_owned()),
        _ => Match::Unclear(owned(left)),
    }
}

/// The calibration that the names tell by themselves.
fn by_name<'a>(images: &str, calibrations: &[&'a str]) -> Option<&'a str> {
    let base = untransported(images);
    let (space, last) = split(base);
    let near: Vec<&&str> = calibrations.iter().filter(|name| split(name).0 == space).collect();
    let own = words(last);
    let with = |wanted: &[String]| near.iter().find(|name| words(split(name).1) == wanted).map(|name| **name);
    let in_space = with(&own).or_else(|| with(&[]));
    in_space.or_else(|| {
        let whole = words(base);
        let mut same = calibrations.iter().filter(|name| !whole.is_empty() && words(name) == whole);
        same.next().filter(|_| same.next().is_none()).copied()
    })
}

/// Whether names say that a calibration is another camera's than the images: each is called by words that the other lacks, or the
/// calibration is a depth or infrared camera's.
fn are_distinct(calibration: &str, images: &str) -> bool {
    /// Cameras that stand beside one of colours.
    const NOT_COLOUR: [&str; 5] = ["depth", "ir", "infra", "infra1", "infra2"];
    let (info, own) = (words(calibration), words(untransported(images)));
    let lacks = |of: &[String], word: &String| !of.contains(word);
    info.iter().any(|word| lacks(&own, word)) && own.iter().any(|word| lacks(&info, word))
        || info.iter().any(|word| lacks(&own, word) && NOT_COLOUR.contains(&word.as_str()))
}

/// Whether a calibration lies in a namespace above the images', in which no other camera is.
fn is_above(calibration: &str, images: &str, all: &[&str]) -> bool {
    let space = format!("{}/", split(calibration).0);
    images.starts_with(&space) && all.iter().all(|other| is_same(other, images) || !other.starts_with(&space))
}

/// Whether two topics are of one camera.
fn is_same(a: &str, b: &str) -> bool {
    let (a, b) = (untransported(a), untransported(b));
    a == b || split(a).0 == split(b).0 && words(split(a).1) == words(split(b).1)
}

fn untransported(topic: &str) -> &str {
    match topic.rsplit_once('/') {
        Some((base, last)) if TRANSPORTS.contains(&last) => base,
        _ => topic,
    }
}

/// Namespace and name.
fn split(topic: &str) -> (&str, &str) {
    topic.rsplit_once('/').unwrap_or(("", topic))
}

/// What tells a camera from others in a name.
fn words(name: &str) -> Vec<String> {
    let words = name.split(['/', '_']).map(str::to_ascii_lowercase);
    words.filter(|word| !word.is_empty() && !COMMON.contains(&word.as_str())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(images: &str, all: &[&str], calibrations: &[&str]) -> String {
        match calibration_of(images, all, calibrations) {
            Match::Found(name) => name,
            Match::Others(names) => format!("others: {}", names.join(" ")),
            Match::Unclear(names) => format!("unclear: {}", names.join(" ")),
        }
    }

    #[test]
    fn a_calibration_is_that_of_its_namespace() {
        let infos = ["/cam0/camera_info", "/cam1/camera_info", "/cam10/camera_info"];
        let all = ["/cam0/image_raw", "/cam1/image_raw/compressed", "/cam10/image_raw"];
        for (images, info) in all.iter().zip(infos) {
            assert_eq!(found(images, &all, &infos), info);
        }
        // By shared letters alone cam1 would have been given cam10's, and the depth camera the colour camera's.
        let all = ["/cam1/image_raw", "/cam10/image_raw"];
        assert_eq!(found("/cam1/image_raw", &all, &infos[2..]), "others: /cam10/camera_info");
        let all = ["/camera/rgb/image_color", "/camera/depth/image"];
        assert_eq!(found(all[1], &all, &["/camera/rgb/camera_info"]), "others: /camera/rgb/camera_info");
        assert_eq!(found(all[0], &all, &["/camera/rgb/camera_info"]), "/camera/rgb/camera_info");
        assert_eq!(
            found("/camera/image", &["/camera/image"], &["/camera/calibration"]),
            "/camera/calibration"
        );
    }

    #[test]
    fn names_tell_where_namespaces_do_not() {
        let pair = ["/rig/image_left", "/rig/image_right"];
        let infos = ["/rig/camera_info_left", "/rig/camera_info_right"];
        assert_eq!([found(pair[0], &pair, &infos), found(pair[1], &pair, &infos)], infos);
        let recorder = ["/device_0/sensor_1/Color_0/image/data", "/device_0/sensor_0/Depth_0/image/data"];
        let infos =
            ["/device_0/sensor_0/Depth_0/info/camera_info", "/device_0/sensor_1/Color_0/info/camera_info"];
        assert_eq!(found(recorder[0], &recorder, &infos), infos[1]);
        assert_eq!(
            found("/image", &["/image", "/image/compressed"], &["/front/camera_info"]),
            "/front/camera_info"
        );
        let above = ["/camera/rgb/image_raw", "/other/image"];
        assert_eq!(found(above[0], &above, &["/camera/camera_info"]), "/camera/camera_info");
    }

    #[test]
    fn what_nothing_tells_is_not_guessed() {
        let two = ["/front/camera_info", "/rear/camera_info"];
        assert_eq!(found("/video", &["/video"], &two), "unclear: /front/camera_info /rear/camera_info");
        let images = ["/a/image", "/b/image"];
        assert_eq!(found("/a/image", &images, &["/calibration"]), "unclear: /calibration");
        assert_eq!(found("/a/image", &images, &[]), "others: ");
        for (images, info) in [
            ("/front/image_raw", "/rear/camera_info"),
            ("/camera1/image_raw", "/camera10/camera_info"),
            ("/camera/color/image_raw", "/camera/depth/camera_info"),
        ] {
            assert_eq!(found(images, &[images], &[info]), format!("unclear: {info}"));
        }
    }

    #[test]
    fn rectified_images_are_recognised_by_name() {
        for name in [
            "/cam/image_rect",
            "/left/image_rect_color/compressed",
            "/camera/infra1/image_rect_raw",
            "/a/rectified/image",
        ] {
            assert!(is_rectified(name), "{name}");
        }
        for name in [
            "/cam/image_raw",
            "/camera/image_color",
            "/direct/image",
            "/rectory/image",
            "/rect_robot/cam/image_raw",
        ] {
            assert!(!is_rectified(name), "{name}");
        }
    }
}
