use geometry::{GrayImage, Pinhole};
use slam_direct::{Agent, Frame, Params};
use std::io::Write;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let dir = std::path::Path::new(&args[1]);
    let limit: usize = args.get(3).map_or(usize::MAX, |s| s.parse().unwrap());
    let yaml = std::fs::read_to_string(dir.join("camera.yaml")).unwrap();
    let get = |k: &str| -> String {
        yaml.lines()
            .find(|l| l.starts_with(&format!("{k}:")))
            .unwrap()
            .split_once(':')
            .unwrap()
            .1
            .trim()
            .to_string()
    };
    let num = |k: &str| get(k).parse::<f64>().unwrap();
    let d: Vec<f64> = get("distortion")
        .trim_matches(&['[', ']'][..])
        .split(',')
        .filter_map(|s| s.trim().parse().ok())
        .collect();
    let cam = Pinhole {
        width: num("width") as usize,
        height: num("height") as usize,
        fx: num("fx"),
        fy: num("fy"),
        cx: num("cx"),
        cy: num("cy"),
    };
    // output camera: same intrinsics
    let out = cam;
    let table: Option<Vec<(f32, f32)>> = (!d.is_empty()).then(|| {
        (0..out.width * out.height)
            .map(|i| {
                let (u, v) = ((i % out.width) as f64, (i / out.width) as f64);
                let (x, y) = ((u - out.cx) / out.fx, (v - out.cy) / out.fy);
                let r2 = x * x + y * y;
                let k = 1.0 + d[0] * r2 + d[1] * r2 * r2 + d[4] * r2 * r2 * r2;
                let xd = x * k + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x);
                let yd = y * k + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y;
                ((xd * cam.fx + cam.cx) as f32, (yd * cam.fy + cam.cy) as f32)
            })
            .collect()
    });
    let mut params = Params::default();
    if let Ok(p) = std::env::var("LB_PARAMS") {
        params = serde_json::from_str(&p).unwrap();
    }
    let mut agent = Agent::new(out, Box::new(place_recog::ThumbnailIndex::default()), params);
    let times = std::fs::read_to_string(dir.join("times.txt")).unwrap();
    let mut total = 0.0;
    let mut n = 0;
    let mut worst: f64 = 0.0;
    let mut lost = 0;
    let mut kfs = 0;
    for (index, line) in times.lines().filter(|l| !l.starts_with('#')).take(limit).enumerate() {
        let (t, f) = line.split_once(' ').unwrap();
        let img = image::open(dir.join(f.trim())).unwrap().into_luma8();
        let img = GrayImage::from_vec(img.width() as usize, img.height() as usize, img.into_raw()).unwrap();
        let img = match &table {
            None => img,
            Some(table) => GrayImage::from_vec(
                out.width,
                out.height,
                table
                    .iter()
                    .map(|&(x, y)| {
                        let x = x.clamp(0.0, img.width() as f32 - 1.0);
                        let y = y.clamp(0.0, img.height() as f32 - 1.0);
                        img.bilinear(x, y).round() as u8
                    })
                    .collect(),
            )
            .unwrap(),
        };
        let start = std::time::Instant::now();
        let r = agent.process(Frame { index: index as u64, timestamp: t.parse().unwrap(), image: img });
        let ms = start.elapsed().as_secs_f64() * 1e3;
        total += ms;
        n += 1;
        worst = worst.max(ms);
        if r.state != slam_direct::TrackingState::Tracking {
            lost += 1;
            if std::env::var("LB_DEBUG").is_ok() {
                eprintln!("{index} {:?} {:?}", r.state, r.reason);
            }
        }
        if r.new_keyframe.is_some() {
            kfs += 1;
        }
    }
    let start = std::time::Instant::now();
    agent.finish();
    if let Ok(f) = std::env::var("LB_KF") {
        let mut out = std::fs::File::create(f).unwrap();
        for k in agent.map().keyframes.values() {
            let v = k.world_from_keyframe.rigid().to_tum();
            writeln!(
                out,
                "{:.6} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
                k.timestamp, v[0], v[1], v[2], v[3], v[4], v[5], v[6]
            )
            .unwrap();
        }
    }
    let mut out = std::fs::File::create(&args[2]).unwrap();
    for p in agent.map().trajectory() {
        let v = p.world_from_camera.to_tum();
        writeln!(
            out,
            "{:.6} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            p.timestamp, v[0], v[1], v[2], v[3], v[4], v[5], v[6]
        )
        .unwrap();
    }
    println!(
        "{} frames, mean {:.1} ms, worst {:.0} ms, not tracked {lost}, keyframes {kfs}, finish {:.0} ms",
        n,
        total / n as f64,
        worst,
        start.elapsed().as_secs_f64() * 1e3
    );
}
