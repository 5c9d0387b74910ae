//! COLMAP, the format most tools for photogrammetry and radiance fields read
//! (<https://colmap.github.io/format.html>, text).

use super::posed_images::{IMAGES, PIXEL_CENTRE, PosedImages};
use super::save;
use crate::{Map, MapError};
use std::io::{self, Write};
use std::path::Path;

/// Where a model is looked for within a project.
const MODEL: &str = "sparse/0";

/// Writes the keyframes of a map as a COLMAP project: the undistorted images in `images/`, and in `sparse/0/` the model
/// as text, `cameras.txt` (a `PINHOLE` for each agent), `images.txt` and `points3D.txt`. Lengths are the map's; pixel centres are
/// at a half, as COLMAP has them. Returns the number of images and of points.
///
/// # Errors
/// [`MapError::Sensor`] for maps of LiDARs, and when a file cannot be written.
pub fn save_colmap(folder: impl AsRef<Path>, map: &Map) -> Result<(usize, usize), MapError> {
    let (folder, posed) = (folder.as_ref(), PosedImages::of(map)?);
    let model = folder.join(MODEL);
    std::fs::create_dir_all(&model).map_err(|reason| MapError::write(&model, reason))?;
    posed.save_images(&folder.join(IMAGES))?;
    save(&model.join("cameras.txt"), |out| write_cameras(out, &posed))?;
    save(&model.join("images.txt"), |out| write_images(out, &posed))?;
    save(&model.join("points3D.txt"), |out| write_points(out, &posed))?;
    Ok((posed.images.len(), posed.points.len()))
}

fn write_cameras(out: &mut impl Write, posed: &PosedImages) -> io::Result<()> {
    writeln!(out, "# CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY")?;
    for (id, camera) in &posed.cameras {
        let (cx, cy) = (camera.cx + PIXEL_CENTRE, camera.cy + PIXEL_CENTRE);
        let (width, height) = (camera.width, camera.height);
        writeln!(out, "{} PINHOLE {width} {height} {} {} {cx} {cy}", id.0 + 1, camera.fx, camera.fy)?;
    }
    Ok(())
}

fn write_images(out: &mut impl Write, posed: &PosedImages) -> io::Result<()> {
    writeln!(
        out,
        "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, and on the next line X Y POINT3D_ID of its points"
    )?;
    let mut seen = vec![Vec::new(); posed.images.len()];
    for (number, point) in posed.points.iter().enumerate() {
        for (place, pixel) in &point.track {
            seen[*place].push((pixel, number + 1));
        }
    }
    for (place, (image, seen)) in posed.images.iter().zip(&seen).enumerate() {
        let [x, y, z, qx, qy, qz, qw] = image.camera_from_world.to_tum();
        let camera = image.keyframe.agent.0 + 1;
        writeln!(out, "{} {qw} {qx} {qy} {qz} {x} {y} {z} {camera} {}", place + 1, image.name)?;
        let line: Vec<String> = seen
            .iter()
            .map(|(pixel, point)| format!("{} {} {point}", pixel.x + PIXEL_CENTRE, pixel.y + PIXEL_CENTRE))
            .collect();
        writeln!(out, "{}", line.join(" "))?;
    }
    Ok(())
}

fn write_points(out: &mut impl Write, posed: &PosedImages) -> io::Result<()> {
    writeln!(out, "# POINT3D_ID X Y Z R G B ERROR, then IMAGE_ID POINT2D_IDX of all that see it")?;
    let mut counts = vec![0usize; posed.images.len()];
    for (number, point) in posed.points.iter().enumerate() {
        let (p, [red, green, blue]) = (point.position, point.color);
        write!(out, "{} {} {} {} {red} {green} {blue} {}", number + 1, p.x, p.y, p.z, point.error)?;
        for (place, _) in &point.track {
            write!(out, " {} {}", place + 1, counts[*place])?;
            counts[*place] += 1;
        }
        writeln!(out)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::united;

    fn lines(path: &Path) -> Vec<Vec<String>> {
        let text = std::fs::read_to_string(path).unwrap();
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        lines.map(|line| line.split_whitespace().map(str::to_owned).collect()).collect()
    }

    /// Reads the model back by COLMAP's rules and projects each point into each image that is said to see it.
    #[test]
    fn every_track_points_to_what_its_images_say() {
        let (folder, map) = (tempfile::tempdir().unwrap(), united());
        let (images, points) = save_colmap(folder.path(), &map).unwrap();
        assert_eq!(images, map.keyframes.len());
        let [cameras, pictures, tracks] = ["cameras", "images", "points3D"]
            .map(|name| lines(&folder.path().join(MODEL).join(format!("{name}.txt"))));
        assert_eq!((cameras.len(), pictures.len(), tracks.len()), (map.agents.len(), 2 * images, points));
        let number = |word: &String| word.parse::<f64>().unwrap();
        let mut errors = 0;
        for track in &tracks {
            let position = nalgebra::Vector3::new(number(&track[1]), number(&track[2]), number(&track[3]));
            let mut squares = Vec::new();
            for seen in track[8..].chunks(2) {
                let (image, index): (usize, usize) = (seen[0].parse().unwrap(), seen[1].parse().unwrap());
                let (pose, points) = (&pictures[2 * (image - 1)], &pictures[2 * (image - 1) + 1]);
                assert_eq!(points[3 * index + 2], track[0]);
                let q: Vec<f64> = pose[1..8].iter().map(number).collect();
                let camera_from_world = geometry::Se3::from_tum([q[4], q[5], q[6], q[1], q[2], q[3], q[0]]);
                let camera: Vec<f64> = cameras.iter().find(|camera| camera[0] == pose[8]).unwrap()[2..]
                    .iter()
                    .map(number)
                    .collect();
                let local = camera_from_world * position;
                let (x, y) =
                    (camera[2] * local.x / local.z + camera[4], camera[3] * local.y / local.z + camera[5]);
                squares.push(
                    (x - number(&points[3 * index])).powi(2) + (y - number(&points[3 * index + 1])).powi(2),
                );
            }
            let error = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
            assert!((error - number(&track[7])).abs() <= 1e-6 * (1.0 + error), "{error} {}", track[7]);
            assert!(squares[0] < 1e-9, "the host sees its point where it is");
            errors += 1;
        }
        assert!(errors > 0);
        for line in pictures.iter().step_by(2) {
            assert!(folder.path().join(IMAGES).join(&line[9]).is_file());
        }
    }
}
