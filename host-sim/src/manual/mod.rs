//! The manual of the language, `docs/COMMANDS.md`, made from the command tree and a live controller.

mod commands;
mod errors;
mod settings;

/// The whole manual.
pub fn text() -> String {
    let [rules, links, saving, safety, light, compare, status, later] = [
        include_str!("rules.md"),
        include_str!("links.md"),
        include_str!("saving.md"),
        include_str!("safety.md"),
        include_str!("light.md"),
        include_str!("compare.md"),
        include_str!("status.md"),
        include_str!("later.md"),
    ];
    let (sections, settings, errors) = (commands::sections(), settings::table(), errors::table());
    format!(
        "<!-- Made by `host-sim manual -o docs/COMMANDS.md` from src/scpi/tree/table.rs. -->\n\
         # The commands of the stage controller\n\n\
         {rules}\n{links}\n{saving}\n{safety}\n{light}\n{compare}\n\
         ## Commands\n\n\
         Every command can also raise the errors of syntax, -101 to -161.\n\n\
         {sections}\
         ## Settings\n\n\
         Range and default of every setting, as a controller with the calibration of the machine `paper` answers them.\n\
         DEF is the calibration's value where it has one.\n\n\
         {settings}\n\
         {status}\n\
         ## Errors\n\n\
         `SYST:ERR?` takes the oldest error from the queue of the link, `0,\"No error\"` when it is empty. The text of\n\
         an error may name what it is about behind a `;`:\n\
         `-222,\"Data out of range;AXIS2 6200.000 um above 5000.000 um\"`.\n\n\
         {errors}\n\
         {later}"
    )
}
