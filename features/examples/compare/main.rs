//! Compares who finds features, and what of them a codec keeps, on pairs of images with true poses:
//! `cargo run --release -p loopbox-features --features opencv-sift --example compare -- DATA [SETS [MAKERS [RATIO]]]`, where DATA is
//! the folder of the sequences, SETS a part of a set's name, MAKERS the makers, with commas, and RATIO the ratio test's.
//!
//! Of each set of pairs and each pair of makers it tells the matches that survive mutual choice and ratio test,
//! and those of them within 3 pixels of the true epipolar line; where there is true depth also those within 3 pixels
//! of the true place, and the repeatability: of the key points both images see, the share that the other image has
//! within 2 pixels and at a scale within √2.

mod judge;
mod pairs;

use features::{Features, SiftParams};
use geometry::GrayImage;
use judge::Tally;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// A way from an image to features.
struct Maker {
    name: &'static str,
    make: fn(&GrayImage) -> Features,
}

/// Bytes that codes took so far.
static CODED: AtomicUsize = AtomicUsize::new(0);

const MAKERS: &[Maker] = &[
    Maker { name: "loopbox", make: |image| features::sift(image, &SiftParams::default()).expect("pixels") },
    Maker { name: "coded", make: coded },
    #[cfg(feature = "opencv-sift")]
    Maker {
        name: "opencv",
        make: |image| {
            use features::Extractor;
            features::OpenCvSift::default().extract(image).expect("pixels")
        },
    },
];

/// Features written and read again.
fn coded(image: &GrayImage) -> Features {
    let found = features::sift(image, &SiftParams::default()).expect("pixels");
    let bytes = features::codec::encode(&found);
    CODED.fetch_add(bytes.len(), Ordering::Relaxed);
    features::codec::decode(&bytes).expect("just encoded")
}

/// The time this thread has had a processor, so that what else the machine does tells little: Linux counts it.
fn processor_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    Duration::from_nanos(text.split(' ').next().and_then(|n| n.parse().ok()).unwrap_or(0))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let data = arguments.next().ok_or("usage: compare DATA [SETS [MAKERS [RATIO]]]")?;
    let wanted = arguments.next().unwrap_or_default();
    let wanted_makers = arguments.next().unwrap_or_default();
    let ratio: f64 = arguments.next().map_or(Ok(0.8), |text| text.parse())?;
    let is_wanted =
        |maker: &&Maker| wanted_makers.is_empty() || wanted_makers.split(',').any(|m| m == maker.name);
    let makers: Vec<&Maker> = MAKERS.iter().filter(is_wanted).collect();
    for set in pairs::sets(data.as_ref())? {
        if !wanted.is_empty() && !set.name.contains(&wanted) {
            continue;
        }
        let mut found: BTreeMap<(usize, usize), Features> = BTreeMap::new();
        println!("{}: {} pairs of {} images", set.name, set.pairs.len(), set.views.len());
        for (m, maker) in makers.iter().enumerate() {
            let mut times: Vec<Duration> = Vec::new();
            let mut count = 0;
            for (v, view) in set.views.iter().enumerate() {
                let start = processor_time();
                let features = (maker.make)(&view.image);
                times.push(processor_time().saturating_sub(start));
                count += features.len();
                found.insert((m, v), features);
            }
            let coded = CODED.swap(0, Ordering::Relaxed);
            if coded > 0 {
                let each = coded as f64 / count as f64;
                println!(
                    "  {:10} {} bytes an image, {each:.1} a feature",
                    maker.name,
                    coded / set.views.len()
                );
            }
            times.sort();
            let median = times[times.len() / 2].as_secs_f64() * 1e3;
            println!("  {:10} {:5} features an image, {median:.1} ms", maker.name, count / set.views.len());
        }
        for (a, first) in makers.iter().enumerate() {
            for (b, second) in makers.iter().enumerate() {
                let mut tally = Tally::default();
                for &(source, target) in &set.pairs {
                    let features = (&found[&(a, source)], &found[&(b, target)]);
                    tally.add(ratio, (&set.views[source], features.0), (&set.views[target], features.1));
                }
                println!("  {:10} {:10} {tally}", first.name, second.name);
            }
        }
    }
    Ok(())
}
