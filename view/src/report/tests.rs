use super::*;
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use loopbox_tests::pages::{assert_points_nowhere, embedded, opened};
use map::{AgentId, Edge, EdgeKind, FramePose, Keyframe, KeyframeId, SemiDense};
use nalgebra::{SMatrix, UnitQuaternion, Vector3};
use std::sync::Arc;

const HOSTILE: &str = "</script><script>alert('x')</script>\"&<!-- {{data}} \u{2028}";

/// A map of `count` keyframes along a bend, with a depth at every `spacing`-th pixel.
fn bend(count: u32, spacing: usize) -> Map {
    let camera = Pinhole { width: 160, height: 120, fx: 105.0, fy: 105.0, cx: 79.5, cy: 59.5 };
    let mut map = Map::new(camera);
    for i in 0..count {
        let at = i as f64 * 0.2;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::y() * at * 0.1);
        let pixels: Vec<u8> = (0..160 * 120).map(|p| (p * (7 + i as usize) % 251) as u8).collect();
        let pixel: Vec<u32> = (0..160 * 120).step_by(spacing).map(|p| p as u32).collect();
        let inverse_depth: Vec<f32> = pixel.iter().map(|p| 0.1 + (p % 97) as f32 * 0.005).collect();
        let variance = inverse_depth.iter().map(|d| (d * 0.02).powi(2)).collect();
        let id = KeyframeId(i);
        let keyframe = Keyframe {
            id,
            agent: AgentId::default(),
            timestamp: at,
            frame_index: 3 * i as u64,
            world_from_keyframe: Sim3::new(rotation, Vector3::new(at, 0.0, 0.1 * at * at), 1.1),
            image: Arc::new(GrayImage::from_vec(160, 120, pixels).unwrap()),
            color: None,
            scan: None,
            semi_dense: SemiDense { pixel: pixel.into(), inverse_depth: inverse_depth.into(), variance }
                .into(),
            points: Vec::new(),
            features: None,
            words: None,
        };
        map.keyframes.insert(id, keyframe);
        map.frames.push(FramePose {
            timestamp: at,
            frame_index: 3 * i as u64,
            reference: id,
            keyframe_from_frame: Se3::identity(),
        });
    }
    for i in 1..count {
        map.edges.push(Edge {
            from: KeyframeId(i - 1),
            to: KeyframeId(i),
            from_from_to: Sim3::identity(),
            information: SMatrix::identity(),
            kind: EdgeKind::Odometry,
        });
    }
    map
}

fn rows(count: u64) -> Vec<FrameRow> {
    let states = [TrackingState::Starting, TrackingState::Tracking, TrackingState::Lost];
    (0..count)
        .map(|i| FrameRow {
            frame_index: i,
            timestamp: i as f64 / 15.0,
            ms: if i == 5 { f32::NAN } else { 8.0 + (i % 7) as f32 },
            matched_points: 900 + i as usize,
            inlier_share: 0.9,
            rmse: 4.0,
            state: states[i as usize % 3],
        })
        .collect()
}

fn page_of(title: &str, map: &Map, rows: &[FrameRow]) -> String {
    let numbers =
        [("Frames tracked".to_owned(), "90 of 90".to_owned()), (title.to_owned(), title.to_owned())];
    render(&ReportInput { title, map, rows, numbers: &numbers }).unwrap()
}

#[test]
fn nothing_points_outside() {
    assert_points_nowhere(&page_of("run", &bend(4, 9), &rows(12)));
}

#[test]
fn hostile_text_stays_text() {
    let mut map = bend(3, 9);
    let agent = map.agents.get_mut(&AgentId::default()).unwrap();
    agent.provenance.insert(HOSTILE.to_owned(), HOSTILE.to_owned());
    let (plain, hostile) = (page_of("run", &bend(3, 9), &[]), page_of(HOSTILE, &map, &[]));
    for mark in ["<script", "</script", "<!--", "</title"] {
        assert_eq!(hostile.matches(mark).count(), plain.matches(mark).count(), "{mark}");
    }
    let data = embedded(&hostile);
    assert_eq!(data["provenance"][0][1], HOSTILE);
    assert_eq!(data["numbers"][1][0], HOSTILE);
}

#[test]
fn all_marks_of_the_template_are_filled() {
    let page = page_of("run", &bend(1, 9), &[]);
    assert!(!page.contains("{{"), "a mark is left");
    assert_eq!(page::fill("a{{x}}b{{y}}{{none}}c", &[("x", "{{y}}"), ("y", "2")]), "a{{y}}b2c");
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let (map, rows) = (bend(5, 3), rows(40));
    assert_eq!(page_of("run", &map, &rows), page_of("run", &map.clone(), &rows));
}

#[test]
fn data_says_what_the_map_says() {
    let data = embedded(&page_of("run", &bend(40, 10), &rows(90)));
    assert_eq!(data["scene"]["keyframes"]["count"], 40);
    assert_eq!(data["scene"]["trajectory"]["count"], 40);
    assert_eq!(data["cloud"]["count"], 40 * 1920);
    assert_eq!(data["rows"]["count"], 90);
    assert_eq!(data["gallery"].as_array().unwrap().len(), gallery::MAX_PICTURES);
}

#[test]
fn size_is_bounded_for_large_maps() {
    let map = bend(40, 1);
    let page = page_of("run", &map, &rows(3000));
    let data = embedded(&page);
    assert_eq!(data["cloud"]["total"], 40 * 160 * 120);
    assert_eq!(data["cloud"]["count"], cloud::MAX_POINTS);
    assert!(page.len() < 15_000_000, "{} bytes", page.len());
}

#[test]
fn odd_maps_make_pages_too() {
    let mut odd = bend(3, 50);
    let first = odd.keyframes.get_mut(&KeyframeId(0)).unwrap();
    first.semi_dense.pixel[0] = u32::MAX;
    first.semi_dense.inverse_depth[1] = 0.0;
    first.semi_dense.inverse_depth[2] = f32::NAN;
    first.semi_dense.variance[3] = f32::NAN;
    odd.keyframes.get_mut(&KeyframeId(1)).unwrap().world_from_keyframe.scale = f64::NAN;
    odd.keyframes.get_mut(&KeyframeId(2)).unwrap().image = Arc::new(GrayImage::default());
    let data = embedded(&page_of("odd", &odd, &[]));
    assert_eq!(data["scene"]["keyframes"]["count"], 2);
    assert_eq!(data["gallery"].as_array().unwrap().len(), 1);
    assert_eq!(embedded(&page_of("empty", &bend(0, 1), &[]))["cloud"]["count"], 0);
}

#[test]
fn a_folder_that_is_not_there_is_named() {
    let path = Path::new("/nowhere/at/all/report.html");
    let error =
        write(path, &ReportInput { title: "", map: &bend(1, 50), rows: &[], numbers: &[] }).unwrap_err();
    assert!(error.to_string().contains("/nowhere/at/all/report.html"), "{error}");
}

#[test]
fn a_browser_shows_it() {
    for (map, rows) in [(bend(6, 5), rows(30)), (bend(6, 5), Vec::new()), (bend(0, 1), Vec::new())] {
        let Some(dom) = opened(&page_of(HOSTILE, &map, &rows)) else {
            eprintln!("SKIPPED: no Chromium here, the report was not opened in a browser");
            return;
        };
        let works =
            ["complete", "without-3d"].iter().any(|how| dom.contains(&format!(r#"data-report="{how}""#)));
        assert!(works, "the page's scripts did not run to their end");
        assert_eq!(dom.matches("aria-pressed=\"true\"").count(), usize::from(!map.keyframes.is_empty()));
        let timing = dom.split_once(r#"<section id="timing""#).expect("a section").1;
        let is_hidden = timing.split_once('>').expect("its end").0.contains("hidden");
        assert_eq!(is_hidden, rows.is_empty(), "of a map alone nothing is plotted");
    }
}

/// Uses the tools as people do, and leaves what came of it on the page.
const HANDS: &str = r#"<script>
setTimeout(() => {
  const { dataset } = document.documentElement, canvas = document.getElementById("scene"), box = canvas.getBoundingClientRect();
  const press = (id) => document.getElementById(id).click();
  const at = (x, y) => ["pointerdown", "pointerup"].forEach((kind) => canvas.dispatchEvent(new PointerEvent(kind,
    { pointerId: 1, button: 0, clientX: box.left + x * box.width, clientY: box.top + y * box.height })));
  canvas.setPointerCapture = () => {};
  press("measure");
  for (let y = 0.1; y < 0.95; y += 0.04) for (const x of [0.45, 0.7]) at(x, y);
  press("save-cloud");
  dataset.whole = dataset.saved;
  const slider = document.querySelector("[id=cut-sides] input");
  slider.value = 100;
  slider.dispatchEvent(new Event("input", { bubbles: true }));
  press("save-cloud");
  document.querySelector(".plot-table summary").click();
  setTimeout(() => (dataset.figures = document.querySelectorAll(".plot-table tbody tr").length), 100);
  press("fold");
  dataset.folded = document.getElementById("panel").hidden;
  press("play");
  const time = document.getElementById("player-at");
  time.value = time.max;
  time.dispatchEvent(new Event("input", { bubbles: true }));
}, 300);
</script></body>"#;

#[test]
fn its_tools_work_in_a_browser() {
    let page = page_of("run", &bend(6, 5), &rows(30)).replace("</body>", HANDS);
    let Some(untouched) = opened(&page) else {
        eprintln!("SKIPPED: no Chromium here, the tools were not used in a browser");
        return;
    };
    assert!(!untouched.contains("data-whole="), "a script that is not the page's own does not run");
    let hands = HANDS.trim_start_matches("<script>").split("</script>").next().unwrap();
    let page = page.replacen("script-src ", &format!("script-src {} ", page::allowed(hands)), 1);
    let dom = opened(&page).expect("as before");
    let number = |name: &str| -> f64 {
        let (_, rest) = dom.split_once(&format!("data-{name}=\"")).unwrap_or_else(|| panic!("no {name}"));
        rest.split_once('"').unwrap().0.parse().unwrap()
    };
    assert_eq!(number("figures"), 24.0, "the plots are a table as well");
    if dom.contains(r#"data-report="without-3d""#) {
        eprintln!("SKIPPED: this Chromium draws no 3-D, its tools were not used");
        return;
    }
    // The scene is some twenty units long.
    let measured = number("measured");
    assert!(measured > 0.01 && measured < 100.0, "{measured}");
    assert_eq!(number("whole"), 6.0 * (160.0 * 120.0 / 5.0));
    assert!(number("saved") > 0.0 && number("saved") < number("whole"), "half of it was cut away");
    assert!(dom.contains(r#"data-folded="true""#));
    // The last of the frames.
    assert_eq!(number("played"), 5.0);
}
