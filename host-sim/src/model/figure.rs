//! Fig. 5 as SVG: sections through accuracy fields, one row per field, one panel for each of Ex, Ey, Ez.

use super::accuracy::Accuracy;
use super::field::{Field, Motion, worst_pose};
use super::topology::coordinate;
use std::fmt::Write;

const PANEL: f64 = 210.0;
const GAP: f64 = 90.0;
const LEFT: f64 = 70.0;
const TOP: f64 = 70.0;
const ROW: f64 = 345.0;
const WIDTH: f64 = LEFT + 3.0 * PANEL + 2.0 * GAP + 50.0;
/// Colours of a panel.
const SHADES: usize = 48;
/// Contour lines of a panel.
const CONTOURS: usize = 5;
/// A field that varies by less than this is drawn as constant, um.
const FLAT: f64 = 5e-5;
/// From low to high, equally far from each other, dark to light so that it can be read without colour.
const COLOURS: [[f64; 3]; 5] =
    [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];

/// A field with what stands above it.
#[derive(Clone, Copy, Debug)]
pub struct FigureRow<'a> {
    /// What the row shows.
    pub title: &'a str,
    /// The field.
    pub field: &'a Field,
}

/// The figure of an accuracy analysis: errors of the same sign as in the paper's Fig. 5, then the machine before and
/// after compensation, over linear and over angular motion.
pub fn accuracy_figure(accuracy: &Accuracy) -> String {
    let mut rows = Vec::new();
    for part in &accuracy.motions {
        let (same, before, after) = match part.motion {
            Motion::Linear => (
                "Linear motion, all errors of the same sign (Fig. 5)",
                "Linear motion, this machine, not compensated, from home",
                "Linear motion, this machine, compensated by the controller's law",
            ),
            Motion::Angular => (
                "Angular motion, all errors of the same sign (Fig. 5)",
                "Angular motion, this machine, not compensated, from home",
                "Angular motion, this machine, compensated by the controller's law",
            ),
        };
        rows.push(FigureRow { title: same, field: &part.fields.same_sign });
        rows.push(FigureRow { title: before, field: &part.fields.before });
        rows.extend(part.fields.after.as_ref().map(|field| FigureRow { title: after, field }));
    }
    figure(&format!("Accuracy of the fibre point, machine {}", accuracy.machine), &rows)
}

/// Sections through fields: each panel lies where the magnitude of its component is largest, has its own scale, and
/// says its range. Errors in um.
pub fn figure(title: &str, rows: &[FigureRow]) -> String {
    let height = TOP + ROW * rows.len() as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    text(&mut svg, LEFT, 28.0, "start", 18, title);
    for (i, row) in rows.iter().enumerate() {
        let top = TOP + ROW * i as f64;
        text(&mut svg, LEFT, top, "start", 14, row.title);
        for component in 0..3 {
            panel(&mut svg, LEFT + (PANEL + GAP) * component as f64, top + 32.0, row.field, component);
        }
    }
    svg + "</svg>\n"
}

fn text(svg: &mut String, x: f64, y: f64, anchor: &str, size: u32, content: &str) {
    let escaped = content.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-size=\"{size}\">{escaped}</text>")
        .expect("a string takes all");
}

/// A coordinate of a motion as people read it.
fn reading(motion: Motion, q: f64) -> String {
    let (value, unit) = match motion {
        Motion::Linear => (q, "um"),
        Motion::Angular => (q.to_degrees(), "deg"),
    };
    // no more digits than a grid needs, no minus before nothing
    let rounded = (value * 1e3).round() / 1e3 + 0.0;
    format!("{rounded} {unit}")
}

fn colour(part: f64) -> String {
    let place = part.clamp(0.0, 1.0) * (COLOURS.len() - 1) as f64;
    let below = (place as usize).min(COLOURS.len() - 2);
    let mix = |c: usize| COLOURS[below][c] + (COLOURS[below + 1][c] - COLOURS[below][c]) * (place - below as f64);
    format!("#{:02x}{:02x}{:02x}", mix(0).round() as u8, mix(1).round() as u8, mix(2).round() as u8)
}

fn panel(svg: &mut String, left: f64, top: f64, field: &Field, component: usize) {
    let grid = &field.grid;
    let value = |i: usize, j: usize, k: usize| field.at([i, j, k])[component];
    let magnitudes: Vec<f64> = field.deviations.iter().map(|d| d.position_um[component].abs()).collect();
    let worst = worst_pose(grid, &magnitudes);
    // an error that depends on one coordinate only must not hide behind it: across lies the one that matters least
    let across = least_important(field, component);
    let [h, v] = match across {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    let place = grid.places(worst)[across];
    let section = |a: usize, b: usize| {
        let mut at = [place; 3];
        at[h] = a;
        at[v] = b;
        value(at[0], at[1], at[2])
    };
    let (columns, rows) = (grid.coordinates[h].len(), grid.coordinates[v].len());
    let all = || (0..columns).flat_map(|a| (0..rows).map(move |b| (a, b)));
    let low = all().map(|(a, b)| section(a, b)).fold(f64::INFINITY, f64::min);
    let high = all().map(|(a, b)| section(a, b)).fold(f64::NEG_INFINITY, f64::max);
    let flat = high - low < FLAT;
    let part = |e: f64| if flat { 0.5 } else { (e - low) / (high - low) };
    let names = grid.motion.axes().map(coordinate);
    let fixed = reading(grid.motion, grid.coordinates[across][place]);
    let head = format!("E{} (um) at {} = {fixed}", ["x", "y", "z"][component], names[across]);
    text(svg, left, top - 8.0, "start", 12, &head);
    let (w, t) = (PANEL / columns as f64, PANEL / rows as f64);
    let mut cells = vec![String::new(); SHADES];
    for (a, b) in all() {
        // a little larger than its share, so that no seam shows
        let (x, y) = (left + w * a as f64, top + PANEL - t * (b + 1) as f64);
        let (right, down) = (w + 0.3, t + 0.3);
        let shade = (part(section(a, b)) * (SHADES - 1) as f64).round() as usize;
        write!(cells[shade], "M{x:.1} {y:.1}h{right:.1}v{down:.1}h-{right:.1}z").expect("a string takes all");
    }
    for (shade, path) in cells.iter().enumerate().filter(|(_, path)| !path.is_empty()) {
        let fill = colour(shade as f64 / (SHADES - 1) as f64);
        writeln!(svg, "<path d=\"{path}\" fill=\"{fill}\"/>").expect("a string takes all");
    }
    let centre = |a: f64, b: f64| (left + w * (a + 0.5), top + PANEL - t * (b + 0.5));
    if !flat {
        let level = |n: usize| low + (high - low) * n as f64 / (CONTOURS + 1) as f64;
        let lines: Vec<_> = (1..=CONTOURS).map(|n| contour(columns, rows, level(n), &section, &centre)).collect();
        // through the noise of steps there are no lines that say anything
        if lines.iter().map(|(pieces, _)| pieces).sum::<usize>() < CONTOURS * 4 * (columns + rows) {
            let path: String = lines.into_iter().map(|(_, path)| path).collect();
            writeln!(svg, "<path d=\"{path}\" stroke=\"white\" stroke-width=\"0.8\" fill=\"none\"/>")
                .expect("a string takes all");
        }
    }
    let ends = |line: &[f64]| [line[0], line[line.len() - 1]].map(|q| reading(grid.motion, q));
    let [first, last] = ends(&grid.coordinates[h]);
    text(svg, left, top + PANEL + 15.0, "start", 10, &first);
    text(svg, left + PANEL / 2.0, top + PANEL + 15.0, "middle", 12, names[h]);
    text(svg, left + PANEL, top + PANEL + 15.0, "end", 10, &last);
    let [first, last] = ends(&grid.coordinates[v]);
    text(svg, left - 4.0, top + PANEL, "end", 10, &first);
    text(svg, left - 4.0, top + PANEL / 2.0, "end", 12, names[v]);
    text(svg, left - 4.0, top + 10.0, "end", 10, &last);
    scale(svg, left, top + PANEL + 26.0, low, high, flat);
}

/// The coordinate along which the component changes least: the smallest of the largest ranges along it.
fn least_important(field: &Field, component: usize) -> usize {
    let [_, m, n] = field.grid.coordinates.each_ref().map(Vec::len);
    let strides = [m * n, n, 1];
    let value = |number: usize| field.deviations[number].position_um[component];
    let range = |axis: usize| {
        let lines = (0..field.grid.len()).filter(|&number| field.grid.places(number)[axis] == 0);
        let along = |start: usize| {
            let points = 0..field.grid.coordinates[axis].len();
            let ends = |(low, high): (f64, f64), e: f64| (low.min(e), high.max(e));
            let (low, high) = points.map(|i| value(start + i * strides[axis])).fold((f64::MAX, f64::MIN), ends);
            high - low
        };
        lines.map(along).fold(0.0, f64::max)
    };
    let ranges = [range(0), range(1), range(2)].map(|r| (r - FLAT).max(0.0));
    // the last of equals: sections over the first two coordinates are the usual ones
    (0..3).rev().min_by(|&a, &b| ranges[a].total_cmp(&ranges[b])).unwrap_or(2)
}

/// One contour line, where a level crosses the edges of the triangles of the grid: number of pieces, and the path.
fn contour(
    columns: usize,
    rows: usize,
    level: f64,
    section: &dyn Fn(usize, usize) -> f64,
    place: &dyn Fn(f64, f64) -> (f64, f64),
) -> (usize, String) {
    let (mut pieces, mut path) = (0, String::new());
    let crossing = |p: (usize, usize), q: (usize, usize)| {
        let (e, f) = (section(p.0, p.1) - level, section(q.0, q.1) - level);
        ((e < 0.0) != (f < 0.0)).then(|| {
            let part = e / (e - f);
            let along = |a: usize, b: usize| a as f64 + (b as f64 - a as f64) * part;
            place(along(p.0, q.0), along(p.1, q.1))
        })
    };
    for a in 1..columns {
        for b in 1..rows {
            let (p, q, r, s) = ((a - 1, b - 1), (a, b - 1), (a, b), (a - 1, b));
            for [u, v, w] in [[p, q, r], [p, r, s]] {
                let ends: Vec<_> = [(u, v), (v, w), (w, u)].into_iter().filter_map(|(m, n)| crossing(m, n)).collect();
                if let [from, to] = ends[..] {
                    write!(path, "M{:.1} {:.1}L{:.1} {:.1}", from.0, from.1, to.0, to.1).expect("a string takes all");
                    pieces += 1;
                }
            }
        }
    }
    (pieces, path)
}

/// The colours from the lowest to the highest value, with both.
fn scale(svg: &mut String, left: f64, top: f64, low: f64, high: f64, flat: bool) {
    const PARTS: usize = 30;
    let w = PANEL / PARTS as f64;
    for n in 0..PARTS {
        let part = if flat { 0.5 } else { n as f64 / (PARTS - 1) as f64 };
        let (x, fill) = (left + w * n as f64, colour(part));
        writeln!(svg, "<rect x=\"{x:.2}\" y=\"{top:.2}\" width=\"{:.2}\" height=\"8\" fill=\"{fill}\"/>", w + 0.3)
            .expect("a string takes all");
    }
    let digits = if low.abs().max(high.abs()) < 10.0 { 4 } else { 2 };
    let number = |e: f64| format!("{:+.digits$}", e + 0.0);
    if flat {
        text(svg, left + PANEL / 2.0, top + 20.0, "middle", 11, &format!("{} everywhere", number(low)));
    } else {
        text(svg, left, top + 20.0, "start", 11, &number(low));
        text(svg, left + PANEL / 2.0, top + 20.0, "middle", 11, &number(0.5 * (low + high)));
        text(svg, left + PANEL, top + 20.0, "end", 11, &number(high));
    }
}
