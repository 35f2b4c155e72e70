//! The store at the front's service. Both calls need standstill and may take a second: whoever owns the step output
//! stops the stream before and starts it again afterwards.

use super::flash::Store;
use super::record::Buffer;
use super::standstill::Standstill;
use crate::controller::front::{Front, Start, StorageRequest};
use crate::error::{Error, ErrorNumber};
use embedded_storage_async::nor_flash::NorFlash;

/// Puts in force what was saved, and where the motors stand: by `kept`, the copy that outlived the reset, or else by the
/// saved record. What cannot be read is told by the front as 106, with the defaults in use. True when a record was read.
///
/// `front` must be as new. Nothing is written.
pub async fn start<F: NorFlash>(
    store: &mut Store<F>,
    front: &mut Front,
    cause: Start,
    kept: Option<Standstill>,
    buffer: &mut Buffer,
) -> bool {
    let (mut found, mut saved) = (false, None);
    match store.load(buffer).await {
        Ok(Some(record)) => match front.apply_record(&record.record) {
            Ok(()) => (found, saved) = (true, record.standstill),
            Err(_) => front.lose_settings(super::StoreError::Contents.at_start()),
        },
        Ok(None) => {}
        Err(error) => front.lose_settings(error.at_start()),
    }
    match (kept, saved) {
        (Some(kept), _) => front.restore(&kept, cause),
        // the record does not know what has moved since
        (None, Some(saved)) => front.restore(&saved, Start::PowerOn),
        (None, None) => {}
    }
    found
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
