//! Maps a folder of scans and prints loops.
use geometry::{Se3, umeyama};
use scans::{Folder, FolderOptions, SweepTiming};
use slam_lidar::mapping::*;
use std::path::Path;
fn main() {
    for arg in std::env::args().skip(1) {
        let path = Path::new(&arg);
        let folder =
            Folder::open(path, &FolderOptions { rate: None, timing: Some(SweepTiming::default()) }).unwrap();
        let text = std::fs::read_to_string(path.join("groundtruth.txt")).unwrap();
        let truth: Vec<(f64, Se3)> = text
            .lines()
            .filter(|l| !l.starts_with('#') && !l.is_empty())
            .map(|l| {
                let v: Vec<f64> = l.split_whitespace().map(|w| w.parse().unwrap()).collect();
                (v[0], Se3::from_tum([v[1], v[2], v[3], v[4], v[5], v[6], v[7]]))
            })
            .collect();
        let at = |time: f64| {
            let i = truth.partition_point(|(t, _)| *t <= time + 1e-9).clamp(1, truth.len() - 1);
            let ((t0, a), (t1, b)) = (truth[i - 1], truth[i]);
            a * Se3::exp(&((a.inverse() * b).log() * ((time - t0) / (t1 - t0))))
        };
        let mut agent = Agent::new(MappingParams::default());
        let mut odo = vec![];
        let mut slow = 0.0f64;
        for f in folder.files() {
            let scan = folder.read(f).unwrap();
            let begin = std::time::Instant::now();
            let (t, closed) = agent.take(&scan);
            odo.push((t.instant, t.world_from_sensor));
            if let Some(l) = closed {
                slow = slow.max(begin.elapsed().as_secs_f64());
                let k = agent.keyframes();
                let tr = at(k[l.from].instant).inverse() * at(k[l.to].instant);
                let e = tr.inverse() * l.alignment.target_from_source;
                println!(
                    "loop {} {} error {:.3} m {:.3} deg  {:?}",
                    l.from,
                    l.to,
                    e.translation.norm(),
                    e.rotation.angle().to_degrees(),
                    l.alignment.evidence
                );
            }
        }
        for l in agent.refused() {
            let k = agent.keyframes();
            let e = (at(k[l.from].instant).inverse() * at(k[l.to].instant)).inverse()
                * l.alignment.target_from_source;
            let d = (at(k[l.from].instant).inverse() * at(k[l.to].instant)).translation.norm();
            let v = &l.alignment.evidence;
            println!(
                "refused {} {} apart {d:.1} error {:.3} m {:.2} deg overlap {:.2} violated {:.3} agreeing {:.2} weak {} trans {:.3}",
                l.from,
                l.to,
                e.translation.norm(),
                e.rotation.angle().to_degrees(),
                v.overlap,
                v.violated,
                v.agreeing,
                v.conditioning.weak,
                v.conditioning.translation
            );
        }
        let ate = |v: &[(f64, Se3)]| {
            let e: Vec<_> = v.iter().map(|(_, p)| p.translation).collect();
            let t: Vec<_> = v.iter().map(|(t, _)| at(*t).translation).collect();
            let a = umeyama::se3(&e, &t).unwrap();
            (e.iter().zip(&t).map(|(e, t)| (a * *e - t).norm_squared()).sum::<f64>() / e.len() as f64).sqrt()
        };
        println!(
            "{arg}: keyframes {} loops {} refused {} ate {:.4} -> {:.4} slowest take with loop {:.3} s",
            agent.keyframes().len(),
            agent.loops().len(),
            agent.refused().len(),
            ate(&odo),
            ate(&agent.trajectory()),
            slow
        );
    }
}
