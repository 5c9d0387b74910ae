//! Tracks folders of scans and prints errors against ground truth.
use geometry::{Se3, umeyama};
use scans::{Folder, FolderOptions, SweepTiming};
use slam_lidar::floam::*;
use slam_lidar::odometry::{Odometry, OdometryParams};
use std::path::Path;
use std::time::Instant;

fn truth(path: &Path) -> Vec<(f64, Se3)> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .filter(|l| !l.starts_with('#') && !l.trim().is_empty())
        .map(|l| {
            let v: Vec<f64> = l.split_whitespace().map(|w| w.parse().unwrap()).collect();
            (v[0], Se3::from_tum([v[1], v[2], v[3], v[4], v[5], v[6], v[7]]))
        })
        .collect()
}

fn at(truth: &[(f64, Se3)], time: f64) -> Option<Se3> {
    let i = truth.partition_point(|(t, _)| *t <= time + 1e-9);
    if i == 0 {
        return None;
    }
    if i == truth.len() {
        return ((time - truth[i - 1].0).abs() < 0.02).then_some(truth[i - 1].1);
    }
    let ((t0, a), (t1, b)) = (truth[i - 1], truth[i]);
    Some(a * Se3::exp(&((a.inverse() * b).log() * ((time - t0) / (t1 - t0)))))
}

fn cpu() -> f64 {
    let s = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    s.split_whitespace().next().unwrap().parse::<f64>().unwrap() * 1e-6
}

fn main() {
    let mut params = OdometryParams::default();
    let mut deskew = true;
    let mut method = String::new();
    let mut ccw = false;
    let mut rms = 0.0;
    let (mut shift, mut skip) = (0.0, 0);
    for arg in std::env::args().skip(1) {
        if let Some((k, v)) = arg.split_once('=') {
            let f = || v.parse::<f64>().unwrap();
            match k {
                "voxel" => {
                    params.surfaces.voxel = f() as f32;
                    params.voxel_of_range = 0.0
                }
                "thick" => params.surfaces.thickness = f() as f32,
                "aspect" => params.surfaces.aspect = f() as f32,
                "width" => params.surfaces.width = f() as f32,
                "least" => params.surfaces.least_points = f() as u32,
                "most" => params.surfaces.most_points = f() as u32,
                "reg" => params.registered = f() as f32,
                "map" => params.mapped = f() as f32,
                "kernel" => params.registration.kernel = f(),
                "cont" => params.registration.continuity = (f(), f() * 0.2),
                "acc" => params.registration.acceleration = (f(), f() * 1.8),
                "corr" => params.registration.correlation = f(),
                "steps" => params.registration.most_steps = f() as usize,
                "eps" => params.registration.least_step = f(),
                "range" => params.range.1 = f() as f32,
                "min" => params.range.0 = f() as f32,
                "method" => method = v.to_owned(),
                "shift" => shift = f(),
                "skip" => skip = f() as usize,
                "ccw" => ccw = f() != 0.0,
                "deskew" => deskew = f() != 0.0,
                _ => panic!("{k}"),
            }
            continue;
        }
        let path = Path::new(&arg);
        let folder = Folder::open(
            path,
            &FolderOptions {
                rate: None,
                timing: deskew.then(|| SweepTiming {
                    spin: if ccw { scans::Spin::CounterClockwise } else { scans::Spin::Clockwise },
                    ..SweepTiming::default()
                }),
            },
        )
        .unwrap();
        let truth = truth(&path.join("groundtruth.txt"));
        let mut odometry = Odometry::new(params);
        let (mut est, mut tru, mut times, mut worst, mut steps, mut inl) =
            (vec![], vec![], vec![], 0.0f64, 0, 0.0);
        let mut feature = match method.as_str() {
            "floam" => Some(FeatureOdometry::new(FeatureMethod::Floam)),
            "a-loam" => Some(FeatureOdometry::new(FeatureMethod::ALoam)),
            _ => None,
        };
        let wall = Instant::now();
        for file in folder.files() {
            let scan = folder.read(file).unwrap();
            let begin = cpu();
            if let Some(feature) = &mut feature {
                let (instant, pose) = feature.track(&scan).unwrap();
                times.push(cpu() - begin);
                if let Some(t) = at(&truth, instant) {
                    est.push(pose);
                    tru.push(t);
                }
                continue;
            }
            let tracked = odometry.track(&scan);
            times.push(cpu() - begin);
            steps += tracked.steps;
            rms += tracked.rmse;
            inl += tracked.inlier_share;
            worst = worst.max(tracked.conditioning.translation);
            if let Some(pose) = at(&truth, tracked.instant + shift).filter(|_| times.len() > skip) {
                est.push(tracked.world_from_sensor);
                tru.push(pose);
            }
        }
        let p = |v: &[Se3]| v.iter().map(|s| s.translation).collect::<Vec<_>>();
        let align = umeyama::se3(&p(&est), &p(&tru)).unwrap();
        let errors: Vec<f64> =
            est.iter().zip(&tru).map(|(e, t)| ((align * *e).translation - t.translation).norm()).collect();
        let ate = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let max = errors.iter().fold(0.0f64, |a, &b| a.max(b));
        let mut parts = [0.0f64; 3];
        for (e, t) in est.iter().zip(&tru) {
            let d = t.rotation.inverse() * ((align * *e).translation - t.translation);
            for k in 0..3 {
                parts[k] += d[k] * d[k] / est.len() as f64;
            }
        }
        if let Ok(path) = std::env::var("DUMP") {
            let mut text = String::new();
            for (e, t) in est.iter().zip(&tru) {
                let d = t.rotation.inverse() * ((align * *e).translation - t.translation);
                text += &format!("{} {} {} {}\n", t.translation.x, d.x, d.y, d.z);
            }
            std::fs::write(path, text).unwrap();
        }
        let parts = parts.map(|v| (v.sqrt() * 1e3).round());
        let mut way = vec![0.0];
        for w in tru.windows(2) {
            way.push(way.last().unwrap() + (w[1].translation - w[0].translation).norm());
        }
        let (mut drift, mut turn, mut n) = (0.0, 0.0, 0);
        for i in 0..tru.len() {
            let j = way.partition_point(|&d| d < way[i] + 10.0);
            if j >= tru.len() {
                break;
            }
            let e = (tru[i].inverse() * tru[j]).inverse() * (est[i].inverse() * est[j]);
            drift += e.translation.norm() / (way[j] - way[i]);
            turn += e.rotation.angle().to_degrees() / (way[j] - way[i]);
            n += 1;
        }
        times.sort_by(f64::total_cmp);
        println!(
            "{:20} {parts:?} ate {ate:.4} max {max:.3} drift {:.3} % {:.4} deg/m  cpu median {:.1} mean {:.1} ms  steps {:.1} inl {:.2} rmse {:.2} mm weak {worst:.4} voxels {} wall {:.1}",
            &arg[arg.len().saturating_sub(20)..],
            100.0 * drift / n.max(1) as f64,
            turn / n.max(1) as f64,
            times[times.len() / 2],
            times.iter().sum::<f64>() / times.len() as f64,
            steps as f64 / times.len() as f64,
            inl / times.len() as f64,
            rms / times.len() as f64 * 1e3,
            odometry.map().len(),
            wall.elapsed().as_secs_f64()
        );
    }
}
