//! The tables that come with folders of images. The first byte says whose form it is.
#![no_main]

use loopbox_fuzz::scratch;
use sources::SourceOptions;
use std::fs;

const TABLES: [&str; 7] = [
    "times.txt",
    "rgb.txt",
    "mav0/cam0/data.csv",
    "image_0/../times.txt",
    "image_00/timestamps.txt",
    "associations.txt",
    "camera_of_whom.yaml",
];

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((form, table)) = data.split_first() else { return };
    let folder = scratch().join("folder");
    let _ = fs::remove_dir_all(&folder);
    for part in ["images", "mav0/cam0/data", "image_0", "image_00/data"] {
        fs::create_dir_all(folder.join(part)).expect("a folder can be made");
    }
    if *form as usize % TABLES.len() != 3 {
        fs::remove_dir(folder.join("image_0")).expect("an empty folder can be removed");
    }
    for image in ["images/0.png", "images/1.jpg"] {
        fs::write(folder.join(image), "none").expect("a file can be written");
    }
    let path = folder.join(TABLES[*form as usize % TABLES.len()].replace("image_0/../", ""));
    fs::write(path, table).expect("a file can be written");
    let fps = TABLES[*form as usize % TABLES.len()].ends_with("yaml").then_some(10.0);
    if let Ok(mut source) = sources::open(&folder, &SourceOptions { fps, ..SourceOptions::default() }) {
        let _ = sources::sidecar_calibrations(source.info());
        while let Some(frame) = source.next_frame() {
            let _ = frame.picture.into_grey();
        }
    }
});
