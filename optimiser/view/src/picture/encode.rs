//! Pictures as PNG files, several of them as animated PNG and GIF files.
//!
//! Of an animation's later pictures only the rectangle is stored in which something changed, and in it only the pixels
//! that did, the others being transparent: most of a bench stands still.

use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::path::Path;

use color_quant::NeuQuant;

use super::{Image, Rgb};
use crate::ViewError;
use crate::whole::Whole;

/// A channel may differ by so much from what was drawn before it is drawn again: of 255, unseen.
const UNSEEN: u8 = 2;

/// Index of the colour that is none.
const TRANSPARENT: u8 = 255;

/// Every so many pixels teach the palette.
const TAUGHT_BY: i32 = 7;

impl Image {
    /// The picture as the bytes of a PNG file.
    #[must_use]
    pub fn to_png(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width_px as u32, self.height_px as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_compression(png::Compression::High);
        let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&self.rgb));
        debug_assert!(written.is_ok(), "memory takes every byte, and there are as many as the size says");
        bytes
    }

    /// Writes a PNG file, in place of one of that name.
    ///
    /// # Errors
    /// If the system refuses; what was there is then there still.
    pub fn write(&self, path: &Path) -> Result<(), ViewError> {
        let whole = Whole::new(path)?;
        whole.file().write_all(&self.to_png()).map_err(|source| whole.error(source))?;
        whole.commit()
    }
}

/// A file that pictures are added to.
pub(super) enum Movie {
    Png(PngMovie),
    Gif(GifMovie),
}

/// Kinds of files that hold an animation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Png,
    Gif,
}

impl Kind {
    /// By the ending of a name.
    pub(super) fn of(path: &Path) -> Result<Self, ViewError> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        match ending.as_deref() {
            Some("png" | "apng") => Ok(Self::Png),
            Some("gif") => Ok(Self::Gif),
            _ => Err(ViewError::Setting {
                what: path.display().to_string(),
                wanted: "the name of an animation must end in .gif, .png or .apng",
            }),
        }
    }
}

impl Movie {
    /// For pictures that are shown for so many seconds each; `palette` is used by GIF.
    pub(super) fn new(
        path: &Path,
        size_px: [usize; 2],
        shown_s: &[f64],
        palette: &[Rgb],
    ) -> Result<Self, ViewError> {
        match Kind::of(path)? {
            Kind::Png => PngMovie::new(path, size_px, shown_s).map(Self::Png),
            Kind::Gif => GifMovie::new(path, size_px, shown_s, palette).map(Self::Gif),
        }
    }

    pub(super) fn add(&mut self, image: &Image) -> Result<(), ViewError> {
        match self {
            Self::Png(movie) => movie.add(image),
            Self::Gif(movie) => movie.add(image),
        }
    }

    /// Everything is in the file; it gets its name by [`Whole::commit`].
    pub(super) fn finish(self) -> Result<Whole, ViewError> {
        let (whole, written) = match self {
            Self::Png(movie) => (movie.whole, movie.writer.finish().map_err(io::Error::from)),
            Self::Gif(movie) => (
                movie.whole,
                movie.encoder.into_inner().map_err(io::Error::other).and_then(|mut file| file.flush()),
            ),
        };
        written.map_err(|source| whole.error(source))?;
        Ok(whole)
    }
}

pub(super) struct PngMovie {
    writer: png::Writer<BufWriter<File>>,
    whole: Whole,
    shown: Shown,
    delays_ms: std::vec::IntoIter<u16>,
}

impl PngMovie {
    fn new(path: &Path, [width, height]: [usize; 2], shown_s: &[f64]) -> Result<Self, ViewError> {
        let whole = Whole::new(path)?;
        let open = || -> io::Result<_> {
            let file = BufWriter::new(whole.file().try_clone()?);
            let mut encoder = png::Encoder::new(file, width as u32, height as u32);
            encoder.set_color(png::ColorType::Rgba);
            encoder.set_compression(png::Compression::High);
            encoder.set_animated(shown_s.len() as u32, 0)?;
            encoder.set_blend_op(png::BlendOp::Over)?;
            encoder.set_dispose_op(png::DisposeOp::None)?;
            Ok(encoder.write_header()?)
        };
        let writer = open().map_err(|source| whole.error(source))?;
        let delays_ms = ticks(shown_s, 1000.0).into_iter();
        Ok(Self { writer, whole, shown: Shown::default(), delays_ms })
    }

    fn add(&mut self, image: &Image) -> Result<(), ViewError> {
        let change = self.shown.change(image);
        let pixels: Vec<u8> = change.pixels.iter().flat_map(|pixel| pixel.map_or([0; 4], opaque)).collect();
        let mut write = || -> io::Result<()> {
            self.writer.set_frame_delay(self.delays_ms.next().unwrap_or(0), 1000)?;
            self.writer.reset_frame_position()?;
            self.writer.set_frame_dimension(change.size[0] as u32, change.size[1] as u32)?;
            self.writer.set_frame_position(change.corner[0] as u32, change.corner[1] as u32)?;
            Ok(self.writer.write_image_data(&pixels)?)
        };
        write().map_err(|source| self.whole.error(source))
    }
}

fn opaque([red, green, blue]: Rgb) -> [u8; 4] {
    [red, green, blue, 255]
}

pub(super) struct GifMovie {
    encoder: gif::Encoder<BufWriter<File>>,
    whole: Whole,
    shown: Shown,
    delays_cs: std::vec::IntoIter<u16>,
    palette: Palette,
}

impl GifMovie {
    fn new(path: &Path, size_px: [usize; 2], shown_s: &[f64], colours: &[Rgb]) -> Result<Self, ViewError> {
        let whole = Whole::new(path)?;
        let open = || -> io::Result<_> {
            let file = BufWriter::new(whole.file().try_clone()?);
            let [width, height] = size_px.map(|size| size as u16);
            let mut table = colours.concat();
            table.resize(3 * 256, 0);
            let mut encoder = gif::Encoder::new(file, width, height, &table).map_err(io::Error::other)?;
            encoder.set_repeat(gif::Repeat::Infinite).map_err(io::Error::other)?;
            Ok(encoder)
        };
        let encoder = open().map_err(|source| whole.error(source))?;
        let delays_cs = ticks(shown_s, 100.0).into_iter();
        Ok(Self { encoder, whole, shown: Shown::default(), delays_cs, palette: Palette::new(colours) })
    }

    fn add(&mut self, image: &Image) -> Result<(), ViewError> {
        let change = self.shown.change(image);
        let mut index = |at: usize, colour: Rgb| {
            let [column, row] =
                [at % change.size[0] + change.corner[0], at / change.size[0] + change.corner[1]];
            self.palette.index([column, row], colour)
        };
        let pixels = change.pixels.iter().enumerate();
        let buffer: Vec<u8> =
            pixels.map(|(at, pixel)| pixel.map_or(TRANSPARENT, |colour| index(at, colour))).collect();
        let frame = gif::Frame {
            delay: self.delays_cs.next().unwrap_or(0),
            dispose: gif::DisposalMethod::Keep,
            transparent: Some(TRANSPARENT),
            left: change.corner[0] as u16,
            top: change.corner[1] as u16,
            width: change.size[0] as u16,
            height: change.size[1] as u16,
            buffer: buffer.into(),
            ..gif::Frame::default()
        };
        self.encoder.write_frame(&frame).map_err(|source| self.whole.error(source))
    }
}

/// What a viewer sees after the pictures so far.
#[derive(Default)]
struct Shown {
    rgb: Vec<u8>,
}

/// What the next picture changes: in a rectangle, pixels with a new colour.
struct Change {
    corner: [usize; 2],
    size: [usize; 2],
    pixels: Vec<Option<Rgb>>,
}

impl Shown {
    fn change(&mut self, image: &Image) -> Change {
        if self.rgb.is_empty() {
            self.rgb.clone_from(&image.rgb);
            let pixels = image.rgb.as_chunks::<3>().0.iter().copied().map(Some).collect();
            return Change { corner: [0, 0], size: [image.width_px, image.height_px], pixels };
        }
        let mut changed = vec![None; image.width_px * image.height_px];
        let [mut low, mut high] = [[usize::MAX; 2], [0; 2]];
        let old = self.rgb.as_chunks_mut::<3>().0;
        for (at, (old, new)) in old.iter_mut().zip(image.rgb.as_chunks::<3>().0).enumerate() {
            if old.iter().zip(new).any(|(old, new)| old.abs_diff(*new) > UNSEEN) {
                let place = [at % image.width_px, at / image.width_px];
                low = [low[0].min(place[0]), low[1].min(place[1])];
                high = [high[0].max(place[0] + 1), high[1].max(place[1] + 1)];
                changed[at] = Some(*new);
                *old = *new;
            }
        }
        if high == [0; 2] {
            // A frame must have a pixel.
            return Change { corner: [0, 0], size: [1, 1], pixels: vec![None] };
        }
        let rows = (low[1]..high[1]).map(|row| row * image.width_px);
        let pixels = rows.flat_map(|row| changed[row + low[0]..row + high[0]].iter().copied()).collect();
        Change { corner: low, size: [high[0] - low[0], high[1] - low[1]], pixels }
    }
}

/// Colours of a GIF file, and which of them is nearest to a colour.
struct Palette {
    colours: Vec<[i32; 3]>,
    /// For each colour at a resolution of six bits a channel; 256 where it was not asked for yet.
    nearest: Vec<u16>,
}

impl Palette {
    fn new(colours: &[Rgb]) -> Self {
        Self {
            colours: colours.iter().map(|colour| colour.map(i32::from)).collect(),
            nearest: vec![256; 1 << 18],
        }
    }

    fn index(&mut self, _place: [usize; 2], colour: Rgb) -> u8 {
        let at = colour.iter().fold(0, |at, part| at << 6 | usize::from(part >> 2));
        if self.nearest[at] > 255 {
            self.nearest[at] = self.search(colour.map(i32::from)) as u16;
        }
        self.nearest[at] as u8
    }

    fn search(&self, colour: [i32; 3]) -> usize {
        let distance = |other: &[i32; 3]| {
            let part = |which: usize| (other[which] - colour[which]).pow(2);
            // Eyes see green best.
            2 * part(0) + 4 * part(1) + part(2)
        };
        let nearest = self.colours.iter().enumerate().min_by_key(|(_, other)| distance(other));
        nearest.map_or(0, |(index, _)| index)
    }
}

/// At most 255 colours for pictures like these, first the one that most of them are.
pub(super) fn palette(images: &[Image], background: Rgb) -> Vec<Rgb> {
    let pixels: Vec<u8> = images
        .iter()
        .flat_map(|image| image.rgb.as_chunks::<3>().0.iter().flat_map(|colour| opaque(*colour)))
        .collect();
    let learnt = NeuQuant::new(TAUGHT_BY, 254, &pixels).color_map_rgb();
    std::iter::once(background).chain(learnt.as_chunks::<3>().0.iter().copied()).collect()
}

/// Durations as whole ticks that never are more than half a tick off the time since the beginning.
fn ticks(shown_s: &[f64], per_second: f64) -> Vec<u16> {
    let mut since_s = 0.0;
    let mut before = 0.0;
    let tick = |shown: &f64| {
        since_s += shown;
        let now: f64 = (since_s * per_second).round();
        let ticks = now - before;
        before = now;
        ticks as u16
    };
    shown_s.iter().map(tick).collect()
}

/// The picture in a PNG file's bytes.
#[cfg(test)]
pub(super) fn decoded(bytes: &[u8]) -> Image {
    let mut reader = png::Decoder::new(io::Cursor::new(bytes)).read_info().expect("a PNG file");
    let mut rgb = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut rgb).expect("pixels");
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    Image { width_px: info.width as usize, height_px: info.height as usize, rgb }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn image(width_px: usize, height_px: usize) -> Image {
        let rgb = (0..3 * width_px * height_px).map(|index| (index * 7 % 251) as u8).collect();
        Image { width_px, height_px, rgb }
    }

    #[test]
    fn a_png_file_reads_back_as_the_picture() {
        for image in [image(16, 16), image(33, 20), image(20, 33)] {
            assert!(decoded(&image.to_png()) == image, "{} x {}", image.width_px, image.height_px);
        }
    }

    #[test]
    fn a_file_has_its_name_only_when_it_is_complete() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("deep/picture.png");
        drop(Whole::new(&path).expect("a file"));
        let names = || fs::read_dir(folder.path().join("deep")).expect("the folder").count();
        assert_eq!(names(), 0);
        image(16, 16).write(&path).expect("a picture");
        image(20, 20).write(&path).expect("a picture in place of a picture");
        assert_eq!(names(), 1);
        assert_eq!(decoded(&fs::read(&path).expect("the picture")).width_px, 20);
        let taken = folder.path().join("deep");
        let error = image(16, 16).write(&taken).expect_err("a folder is there");
        assert!(error.to_string().contains("deep cannot be written"), "{error}");
        assert!(!folder.path().join("deep.part").exists());
    }

    #[test]
    fn ticks_do_not_drift() {
        let ticks = ticks(&[1.0 / 30.0; 300], 100.0);
        assert_eq!(ticks.iter().map(|tick| u32::from(*tick)).sum::<u32>(), 1000);
        assert!(ticks.iter().all(|tick| [3, 4].contains(tick)), "{ticks:?}");
    }

    #[test]
    fn only_what_changed_is_stored() {
        let mut shown = Shown::default();
        let mut image = image(16, 12);
        assert_eq!(shown.change(&image).size, [16, 12]);
        let same = shown.change(&image);
        assert_eq!((same.size, same.pixels), ([1, 1], vec![None]));
        for [column, row] in [[3, 2], [5, 4]] {
            image.blend([column, row], [255; 3], 255);
        }
        let change = shown.change(&image);
        assert_eq!((change.corner, change.size), ([3, 2], [3, 3]));
        assert_eq!(change.pixels.iter().flatten().count(), 2);
        assert_eq!((change.pixels[0], change.pixels[8]), (Some([255; 3]), Some([255; 3])));
    }
}
