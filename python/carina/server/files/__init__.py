"""Files over HTTP: uploads, downloads, reports and the web client."""
