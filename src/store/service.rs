//! The store at the front's service. Both calls need standstill and may take a second: whoever owns the step output
//! stops the stream before and starts it again afterwards.

use super::StoreError;
use super::flash::Store;
use super::record::Buffer;
use super::standstill::Standstill;
use crate::controller::front::{Front, Start, StorageRequest};
use crate::error::{Error, ErrorNumber};
use embedded_storage_async::nor_flash::NorFlash;

/// What a start found in the flash.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// A record, which is in force now.
    pub record: bool,
    /// Where the motors stood when it was saved.
    pub standstill: Option<Standstill>,
}

/// Puts in force what was saved. What was saved and cannot be read is told by the front as 106, with the defaults in
/// use; on a blank flash nothing was saved. `front` must be as new. Nothing is written.
pub async fn start<F: NorFlash>(store: &mut Store<F>, front: &mut Front, buffer: &mut Buffer) -> Found {
    match store.load(buffer).await {
        Ok(Some(saved)) => match front.apply_record(&saved.record) {
            Ok(()) => return Found { record: true, standstill: saved.standstill },
            Err(_) => front.lose_settings(StoreError::Contents.at_start()),
        },
        Ok(None) => {}
        Err(error) => front.lose_settings(error.at_start()),
    }
    Found::default()
}

/// Says where the motors stand, after [`start`]: by `kept`, the copy that outlived the reset, or else by what was
/// saved, which does not know what has moved since.
pub fn stand(front: &mut Front, cause: Start, kept: Option<Standstill>, found: Found) {
    match (kept, found.standstill) {
        (Some(kept), _) => front.restore(&kept, cause),
        (None, Some(saved)) => front.restore(&saved, Start::PowerOn),
        (None, None) => {}
    }
}

/// Does what the front has been asked to do, if anything; true when there was something.
pub async fn serve<F: NorFlash>(store: &mut Store<F>, front: &mut Front, buffer: &mut Buffer) -> bool {
    let Some(request) = front.take_storage_request() else { return false };
    let result = match request {
        StorageRequest::Save => {
            store.save(&front.record(), &front.standstill_record(), buffer).await.map_err(|error| error.at_work())
        }
        StorageRequest::Park => {
            store.park(&front.record(), &front.standstill_record(), buffer).await.map_err(|error| error.at_work())
        }
        StorageRequest::Recall => match store.load(buffer).await {
            Ok(Some(saved)) => front.apply_record(&saved.record),
            Ok(None) => Err(Error::text(ErrorNumber::SettingsConflict, "nothing is saved yet: *SAV saves")),
            Err(error) => Err(error.at_work()),
        },
    };
    front.storage_done(request, result);
    true
}
