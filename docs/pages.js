// Browsers allow no search in pages that are read from the disk: its field would only wait for ever.
if (location.protocol === "file:") document.documentElement.classList.add("from-disk");
