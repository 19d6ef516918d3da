"""Own arrays: depth of one image, and a stack of images translated to another sensor."""

import tactoscope as ts

# Yours in place of these: (n, rows, cols, 3) uint8 RGB, and one image without contact.
stream = ts.open_recording("sample_data/recordings/first_touch.h5").stream("digit")
images = [stream.frame(index).image for index in (3, 5)]
reference = stream.frame(5).reference

depth = ts.depth(images[1], reference, sensor="digit")
print(f"contact of {depth.contact.sum()} pixels, at most {depth.indentation_mm.max():.2f} mm deep")

with ts.open(images, "gelslim", source="digit", reference=reference) as touches:
    generated = [frame.touch.image for frame in touches]
    print(f"{len(generated)} images of {generated[0].shape} pixels", *touches[1].notes, sep="\n- ")
