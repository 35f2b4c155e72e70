//! Residuals as SVG, one picture for each file.

use super::result::{Identification, Residual};
use plotters::prelude::*;

const SIZE: (u32, u32) = (900, 360);
const COLOURS: [RGBColor; 3] = [RGBColor(0, 90, 160), RGBColor(200, 90, 0), RGBColor(0, 130, 90)];

/// SVG text of the residuals of the file with this index, over its lines; rejected readings are red crosses. None for
/// a file without residuals.
pub fn residuals(result: &Identification, file: usize) -> Option<String> {
    let summary = result.files.get(file)?;
    let points: Vec<&Residual> = result.residuals.iter().filter(|residual| residual.file == file).collect();
    let (first, last) = (points.first()?.line as f64, points.last()?.line as f64);
    let kept = points.iter().filter(|residual| !residual.rejected);
    let reach = kept.map(|r| r.value.abs()).fold(3.5 * summary.noise, f64::max) * 1.3;
    let reach = if reach > 0.0 { reach } else { 1.0 };
    let mut columns: Vec<&str> = points.iter().map(|residual| residual.column).collect();
    columns.sort_unstable();
    columns.dedup();
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        let draw = || -> Result<(), Box<dyn std::error::Error + '_>> {
            root.fill(&WHITE)?;
            let title = format!(
                "{}: residuals, rms {:.1} {u}; grey: +-2 sigma of {:.1} {u}; red: left out",
                summary.file,
                summary.rms,
                summary.noise,
                u = summary.unit
            );
            let mut chart = ChartBuilder::on(&root)
                .caption(title, ("sans-serif", 16))
                .margin(10)
                .x_label_area_size(36)
                .y_label_area_size(70)
                .build_cartesian_2d(first - 0.5..last + 0.5, -reach..reach)?;
            chart
                .configure_mesh()
                .light_line_style(TRANSPARENT)
                .bold_line_style(BLACK.mix(0.15))
                .x_desc("line of the file")
                .y_desc(format!("measured less fitted, {}", summary.unit))
                .draw()?;
            let band = [(first - 0.5, -2.0 * summary.noise), (last + 0.5, 2.0 * summary.noise)];
            chart.draw_series(std::iter::once(Rectangle::new(band, BLACK.mix(0.08).filled())))?;
            for (column, colour) in columns.iter().zip(COLOURS.iter().cycle()) {
                let own = points.iter().filter(|r| r.column == *column && !r.rejected);
                let dots = own.map(|r| Circle::new((r.line as f64, r.value), 2, colour.filled()));
                chart.draw_series(dots)?.label(*column).legend(move |at| Circle::new(at, 3, colour.filled()));
            }
            let out = points.iter().filter(|r| r.rejected);
            let crosses =
                out.map(|r| Cross::new((r.line as f64, r.value.clamp(-reach, reach)), 5, RED.stroke_width(2)));
            chart.draw_series(crosses)?;
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .background_style(WHITE.mix(0.8))
                .border_style(BLACK.mix(0.3))
                .draw()?;
            root.present()?;
            Ok(())
        };
        draw().ok()?;
    }
    Some(svg)
}
