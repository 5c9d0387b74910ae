//! The list of cameras, for people and for programs.

use serde_json::{Value, json};
use sources::camera::format::{FormatRequest, Rates, Sizes, choose};
use sources::camera::list::{Details, FoundCamera, NONE_HINT};

/// For people.
pub fn as_text(cameras: &[FoundCamera]) -> String {
    if cameras.is_empty() {
        return format!("no cameras\nhint: {NONE_HINT}");
    }
    let mut lines: Vec<String> = cameras.iter().flat_map(lines_of).collect();
    lines.extend(cameras.iter().find_map(how_to_use));
    lines.join("\n")
}

fn lines_of(found: &FoundCamera) -> Vec<String> {
    let name = format!("{}  {}", found.path.display(), found.name);
    match &found.details {
        Err(reason) => vec![format!("{name}\n  cannot be looked at: {reason}")],
        Ok(Details { identity, formats, others }) => {
            let mut lines = vec![format!("{name}  ({}, {})", identity.driver, identity.bus)];
            for format in formats {
                let sizes = match &format.sizes {
                    // A line a size: there are often ten of them.
                    Sizes::List(sizes) => {
                        sizes.iter().map(|(size, rates)| format!("{size} at {rates}")).collect()
                    }
                    sizes => vec![sizes.to_string()],
                };
                let names = std::iter::once(format.format.name()).chain(std::iter::repeat(""));
                lines.extend(names.zip(sizes).map(|(name, size)| format!("  {name:<5}{size}")));
            }
            if !others.is_empty() {
                lines.push(format!("  not read here: {}", others.join(", ")));
            }
            lines
        }
    }
}

/// The command for the first camera that can be used, with what `--format auto` would take.
fn how_to_use(found: &FoundCamera) -> Option<String> {
    let choice = choose(&found.details.as_ref().ok()?.formats, &FormatRequest::default())?;
    Some(format!(
        "use: loopbox run --camera {} --size {} --calib camera.yaml --out out/mine",
        found.path.display(),
        choice.size
    ))
}

/// For programs.
pub fn as_json(cameras: &[FoundCamera]) -> Value {
    cameras.iter().map(camera).collect()
}

fn camera(found: &FoundCamera) -> Value {
    let mut value = json!({ "path": found.path, "name": found.name });
    match &found.details {
        Err(reason) => value["error"] = json!(reason),
        Ok(Details { identity, formats, others }) => {
            value["driver"] = json!(identity.driver);
            value["bus"] = json!(identity.bus);
            value["formats"] = formats
                .iter()
                .map(|format| json!({ "format": format.format.name(), "sizes": sizes(&format.sizes) }))
                .collect();
            value["other_formats"] = json!(others);
        }
    }
    value
}

fn sizes(sizes: &Sizes) -> Value {
    match sizes {
        Sizes::List(list) => list
            .iter()
            .map(|(size, fps)| json!({ "width": size.width, "height": size.height, "fps": rates(fps) }))
            .collect(),
        Sizes::Range { min, max, step, rates: fps } => json!({
            "min": [min.width, min.height], "max": [max.width, max.height], "step": [step.0, step.1],
            "fps": rates(fps),
        }),
        Sizes::Present(size) => json!([{ "width": size.width, "height": size.height, "fps": null }]),
    }
}

fn rates(rates: &Rates) -> Value {
    match rates {
        Rates::List(list) => json!(list),
        Rates::Range(low, high) => json!({ "min": low, "max": high }),
        Rates::Unknown => Value::Null,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sources::camera::format::{FormatSizes, PixelFormat, Size};
    use sources::camera::node::Identity;

    fn cameras() -> Vec<FoundCamera> {
        let sizes = vec![
            (Size::USUAL, Rates::List(vec![30.0, 15.0])),
            (Size { width: 320, height: 240 }, Rates::Unknown),
        ];
        let identity = Identity { card: "Webcam".into(), driver: "uvcvideo".into(), bus: "usb-1".into() };
        let details = Details {
            identity,
            formats: vec![FormatSizes { format: PixelFormat::Yuyv, sizes: Sizes::List(sizes) }],
            others: vec!["H264".into()],
        };
        vec![
            FoundCamera {
                path: "/dev/video0".into(),
                name: "Other".into(),
                details: Err("no permission".into()),
            },
            FoundCamera { path: "/dev/video2".into(), name: "Webcam".into(), details: Ok(details) },
        ]
    }

    #[test]
    fn the_list_reads_well() {
        let expected = "/dev/video0  Other\n  cannot be looked at: no permission\n\
                        /dev/video2  Webcam  (uvcvideo, usb-1)\n  YUYV 640x480 at 30, 15\n       320x240 at ?\n  \
                        not read here: H264\n\
                        use: loopbox run --camera /dev/video2 --size 640x480 --calib camera.yaml --out out/mine";
        assert_eq!(as_text(&cameras()), expected);
        assert!(as_text(&[]).starts_with("no cameras\nhint: "));
    }

    #[test]
    fn programs_get_the_same() {
        let value = as_json(&cameras());
        assert_eq!(value[0]["error"], "no permission");
        assert_eq!(
            value[1]["formats"][0]["sizes"][0],
            json!({ "width": 640, "height": 480, "fps": [30.0, 15.0] })
        );
        assert_eq!(as_json(&[]), json!([]));
    }
}
