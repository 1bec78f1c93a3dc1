//! Axes of frames, drawn over a picture: red x, green y, blue z.

use nalgebra::Vector3;
use powderline_shared::pose::Pose;

use super::camera::View;
use super::label::Pen;
use super::{FINE, Image, Rgb, V};

const AXES: [(&str, Rgb); 3] = [("x", [205, 55, 45]), ("y", [30, 135, 65]), ("z", [35, 95, 205])];

/// Draws a frame's axes of a length, with their names and its own. One that is not before the camera is left out.
pub(super) fn draw(image: &mut Image, view: &View, pose: &Pose, length_m: f64, name: &str) {
    let pen = Pen::dark(image);
    let pixel = |point_m: &Vector3<f64>| {
        let world: [f64; 3] = pose.world_from_tool(point_m).into();
        let at = view.pixel(&view.local(&V::from(world.map(|x| x as f32))));
        at.map(|[x, y, _]| [x, y].map(|part| part / FINE as f32))
    };
    let Some(origin) = pixel(&Vector3::zeros()) else { return };
    let width_px = (image.height_px as f32 / 220.0).max(1.5);
    let line_px = pen.line_px() as f32;
    let mut middle = [0.0; 2];
    for (axis, (letter, colour)) in AXES.into_iter().enumerate() {
        let along = |share: f64| Vector3::from_fn(|row, _| if row == axis { share * length_m } else { 0.0 });
        let (Some(tip), Some(beyond)) = (pixel(&along(1.0)), pixel(&along(1.15))) else { continue };
        line(image, [origin, tip], width_px, colour);
        write(image, &pen, [beyond[0], beyond[1] - 0.5 * line_px], letter);
        middle = [0, 1].map(|part| middle[part] + (tip[part] - origin[part]) / 3.0);
    }
    // On the side that the axes leave free.
    let away = (middle[0] * middle[0] + middle[1] * middle[1]).sqrt().max(1e-3);
    let aside = [0, 1].map(|part| -middle[part] / away);
    let half_px = 0.5 * pen.width_px(name) as f32;
    let at =
        [origin[0] + aside[0] * (half_px + line_px), origin[1] + aside[1] * 1.2 * line_px - 0.5 * line_px];
    write(image, &pen, at, name);
}

/// Writes with the upper middle at a pixel, as far as that is in the picture.
fn write(image: &mut Image, pen: &Pen, [middle, top]: [f32; 2], text: &str) {
    let left = middle - 0.5 * pen.width_px(text) as f32;
    if left >= 0.0 && top >= 0.0 {
        pen.write(image, [left as usize, top as usize], text);
    }
}

/// A line of a width, its edge smooth.
fn line(image: &mut Image, [from, to]: [[f32; 2]; 2], width_px: f32, colour: Rgb) {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length2 = (way[0] * way[0] + way[1] * way[1]).max(1e-6);
    let reach = 0.5 * width_px + 1.0;
    let span = |axis: usize, size: usize| {
        let [low, high] = [from[axis].min(to[axis]) - reach, from[axis].max(to[axis]) + reach];
        // Conversion to whole numbers saturates.
        (low.max(0.0) as usize).min(size)..(high.max(0.0) as usize).min(size)
    };
    for row in span(1, image.height_px) {
        for column in span(0, image.width_px) {
            let at = [column as f32 + 0.5 - from[0], row as f32 + 0.5 - from[1]];
            let share = ((at[0] * way[0] + at[1] * way[1]) / length2).clamp(0.0, 1.0);
            let aside = [at[0] - share * way[0], at[1] - share * way[1]];
            let distance = (aside[0] * aside[0] + aside[1] * aside[1]).sqrt();
            let cover = (0.5 * width_px + 0.5 - distance).clamp(0.0, 1.0);
            image.blend([column, row], colour, (255.0 * cover) as u8);
        }
    }
}
