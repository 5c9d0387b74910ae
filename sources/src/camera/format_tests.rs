use super::*;

fn size(text: &str) -> Size {
    text.parse().unwrap()
}

fn list(format: PixelFormat, sizes: &[(&str, &[f64])]) -> FormatSizes {
    let sizes = sizes.iter().map(|(text, rates)| (size(text), Rates::List(rates.to_vec()))).collect();
    FormatSizes { format, sizes: Sizes::List(sizes) }
}

/// A usual webcam: large images only compressed at full rate.
fn webcam() -> Vec<FormatSizes> {
    vec![
        list(PixelFormat::Yuyv, &[("640x480", &[30.0, 15.0]), ("1280x720", &[10.0, 5.0])]),
        list(PixelFormat::Mjpg, &[("640x480", &[60.0, 30.0]), ("1280x720", &[30.0])]),
    ]
}

#[test]
fn auto_takes_the_cheapest_format_that_reaches_the_rate() {
    let chosen = |request| choose(&webcam(), &request).map(|c| (c.format, c.size.to_string(), c.rate));
    let request = FormatRequest::default();
    assert_eq!(chosen(request), Some((PixelFormat::Yuyv, "640x480".into(), Some(30.0))));
    let large = FormatRequest { size: Some(size("1280x720")), ..request };
    assert_eq!(chosen(large), Some((PixelFormat::Mjpg, "1280x720".into(), Some(30.0))));
    assert_eq!(
        chosen(FormatRequest { fps: Some(10.0), ..large }),
        Some((PixelFormat::Yuyv, "1280x720".into(), Some(10.0)))
    );
    assert_eq!(
        chosen(FormatRequest { fps: Some(60.0), ..request }),
        Some((PixelFormat::Mjpg, "640x480".into(), Some(60.0)))
    );
    assert_eq!(
        chosen(FormatRequest { fps: Some(200.0), ..request }),
        Some((PixelFormat::Mjpg, "640x480".into(), Some(60.0))),
        "a rate that none reaches: the fastest"
    );
    let grey = [webcam(), vec![list(PixelFormat::Grey, &[("640x480", &[30.0])])]].concat();
    assert_eq!(choose(&grey, &request).unwrap().format, PixelFormat::Grey);
}

#[test]
fn what_is_not_there_is_refused() {
    assert_eq!(
        choose(&webcam(), &FormatRequest { size: Some(size("641x480")), ..FormatRequest::default() }),
        None
    );
    assert_eq!(
        choose(&webcam(), &FormatRequest { format: Some(PixelFormat::Nv12), ..FormatRequest::default() }),
        None
    );
    assert_eq!(choose(&[], &FormatRequest::default()), None);
}

#[test]
fn ranges_and_drivers_that_do_not_say() {
    let range = FormatSizes {
        format: PixelFormat::Nv12,
        sizes: Sizes::Range {
            min: size("16x16"),
            max: size("1920x1080"),
            step: (16, 2),
            rates: Rates::Range(1.0, 60.0),
        },
    };
    let chosen = choose(std::slice::from_ref(&range), &FormatRequest::default()).unwrap();
    assert_eq!((chosen.size, chosen.rate), (Size::USUAL, Some(30.0)));
    assert_eq!(
        choose(&[range], &FormatRequest { size: Some(size("650x480")), ..FormatRequest::default() }),
        None
    );
    let silent = FormatSizes { format: PixelFormat::Yuyv, sizes: Sizes::Present(size("720x576")) };
    let chosen = choose(&[silent], &FormatRequest::default()).unwrap();
    assert_eq!((chosen.size, chosen.rate), (size("720x576"), None));
}

#[test]
fn the_size_nearest_to_the_usual_one_is_taken() {
    let sizes = list(PixelFormat::Grey, &[("320x240", &[30.0]), ("752x480", &[20.0]), ("1280x800", &[30.0])]);
    assert_eq!(choose(&[sizes], &FormatRequest::default()).unwrap().size, size("752x480"));
}

#[test]
fn sizes_and_codes_are_read() {
    assert_eq!(size("640x480"), Size::USUAL);
    for wrong in ["640", "0x480", "640x", "axb", "99999x1", "-1x5"] {
        assert!(wrong.parse::<Size>().is_err(), "{wrong}");
    }
    for format in PixelFormat::ALL {
        assert_eq!(PixelFormat::of_code(format.code()), Some(format));
    }
    assert_eq!(PixelFormat::of_code(*b"H264"), None);
    assert_eq!(rate_text(30_000.0 / 1001.0), "29.97");
    assert_eq!(rate_text(30.0), "30");
}
