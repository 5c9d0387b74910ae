//! Makes the frame in which descriptors are written, from images: as it ships, from those of `render_scenes 60 4`.
//! `cargo run --release -p loopbox-features --example train_basis -- FOLDER [STEP [AXES]] > features/src/codec/shipped.basis`

use features::{Descriptor, SiftParams, sift};
use geometry::GrayImage;
use nalgebra::{DMatrix, DVector};
use std::error::Error;
use std::io::Write;

/// As the codec's.
const MOST: i32 = 20;
const SYMBOLS: usize = 2 * MOST as usize + 1;
const TOTAL: usize = 1 << 14;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = arguments.first().ok_or("usage: train_basis FOLDER [STEP [AXES]]")?;
    let step: f64 = arguments.get(1).map_or(Ok(14.0), |text| text.parse())?;
    let count: usize = arguments.get(2).map_or(Ok(96), |text| text.parse())?;

    let descriptors = descriptors(folder)?;
    let mut mean = DVector::zeros(128);
    let mut products = DMatrix::zeros(128, 128);
    for block in descriptors.chunks(1024) {
        let matrix = DMatrix::from_fn(128, block.len(), |row, column| f64::from(block[column][row]));
        mean += matrix.column_sum();
        products += &matrix * matrix.transpose();
    }
    let number = descriptors.len() as f64;
    mean /= number;
    let covariance = products / number - &mean * mean.transpose();
    let eigen = covariance.symmetric_eigen();
    let mut order: Vec<usize> = (0..128).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    order.truncate(count);
    let kept: f64 = order.iter().map(|&i| eigen.eigenvalues[i]).sum();
    let deviations: Vec<u32> = order.iter().map(|&i| eigen.eigenvalues[i].sqrt().round() as u32).collect();
    eprintln!(
        "{number} descriptors; {:.1} % of the variance, by axis {deviations:?}",
        100.0 * kept / eigen.eigenvalues.sum()
    );

    let axes: Vec<DVector<f64>> =
        order.iter().map(|&i| signed(eigen.eigenvectors.column(i).into())).collect();
    let mut bytes = vec![u8::try_from(count)?];
    bytes.extend((step as f32).to_le_bytes());
    bytes.extend(mean.iter().flat_map(|v| ((v * 256.0).round() as u16).to_le_bytes()));
    bytes.extend(
        axes.iter().flat_map(|axis| axis.iter().flat_map(|v| ((v * 32767.0).round() as i16).to_le_bytes())),
    );
    let mut bits = 0.0;
    for axis in &axes {
        let mut counts = [0usize; SYMBOLS];
        for descriptor in descriptors.iter().step_by(3) {
            let coordinate: f64 = (0..128).map(|i| (f64::from(descriptor[i]) - mean[i]) * axis[i]).sum();
            counts[(((coordinate / step).round() as i32).clamp(-MOST, MOST) + MOST) as usize] += 1;
        }
        let frequencies = frequencies(&counts);
        let sum = counts.iter().sum::<usize>() as f64;
        let cost = |(&count, &frequency): (&usize, &usize)| {
            count as f64 / sum * (TOTAL as f64 / frequency as f64).log2()
        };
        bits += counts.iter().zip(&frequencies).map(cost).sum::<f64>();
        bytes.extend(frequencies.iter().flat_map(|&f| (f as u16).to_le_bytes()));
    }
    eprintln!("{:.1} bytes a descriptor", bits / 8.0);
    std::io::stdout().write_all(&bytes)?;
    Ok(())
}

/// The descriptors of all images of a folder.
fn descriptors(folder: &str) -> Result<Vec<Descriptor>, Box<dyn Error>> {
    let mut files: Vec<_> = std::fs::read_dir(folder)?.collect::<Result<Vec<_>, _>>()?;
    files.sort_by_key(|file| file.file_name());
    let mut all = Vec::new();
    for file in files {
        let image = image::open(file.path())?.into_luma8();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let image = GrayImage::from_vec(width, height, image.into_raw()).ok_or("an image of another size")?;
        all.extend(sift(&image, &SiftParams::default())?.descriptors);
    }
    Ok(all)
}

/// An axis with its largest component positive: it could point either way.
fn signed(axis: DVector<f64>) -> DVector<f64> {
    let largest = axis.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    axis * largest.signum()
}

/// Frequencies that sum to [`TOTAL`], none of them zero.
fn frequencies(counts: &[usize; SYMBOLS]) -> Vec<usize> {
    let sum: usize = counts.iter().sum();
    let mut frequencies: Vec<usize> = counts.iter().map(|&c| 1 + c * (TOTAL - SYMBOLS) / sum).collect();
    let rest = TOTAL - frequencies.iter().sum::<usize>();
    let most = (0..SYMBOLS).max_by_key(|&i| counts[i]).unwrap_or(0);
    frequencies[most] += rest;
    frequencies
}
