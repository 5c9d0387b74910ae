//! Tells the code which of OpenCV's two interfaces to markers there is: until 4.6 the module `aruco` of its contributed
//! ones, from 4.7 on `objdetect`.

fn main() {
    println!("cargo::rustc-check-cfg=cfg(markers_in_objdetect)");
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var_os("CARGO_FEATURE_OPENCV").is_some() && markers_in_objdetect() {
        println!("cargo::rustc-cfg=markers_in_objdetect");
    }
}

/// Whether the system's OpenCV is 4.7 or newer; so it is taken for where nothing tells its version.
#[cfg(feature = "opencv")]
fn markers_in_objdetect() -> bool {
    let probed = |name: &str| pkg_config::Config::new().cargo_metadata(false).probe(name).ok();
    // The crate `opencv` asks in this order too.
    let known = ["opencv4", "opencv"].into_iter().find_map(probed).map(|library| library.version);
    let Some(version) = known.or_else(by_header) else { return true };
    let mut numbers = version.split('.').map(|number| number.parse::<u32>().unwrap_or(0));
    (numbers.next(), numbers.next()) >= (Some(4), Some(7))
}

/// The version in the headers where distributions put them, for systems without pkg-config.
#[cfg(feature = "opencv")]
fn by_header() -> Option<String> {
    let folders = ["/usr/include/opencv4", "/usr/local/include/opencv4", "/opt/homebrew/include/opencv4"];
    let file = |folder| std::fs::read_to_string(format!("{folder}/opencv2/core/version.hpp")).ok();
    let text = folders.into_iter().find_map(file)?;
    let number = |name: &str| -> Option<&str> {
        text.lines()
            .find_map(|line| line.strip_prefix("#define CV_VERSION_")?.strip_prefix(name))
            .map(str::trim)
    };
    Some(format!("{}.{}", number("MAJOR")?, number("MINOR")?))
}

#[cfg(not(feature = "opencv"))]
fn markers_in_objdetect() -> bool {
    false
}
