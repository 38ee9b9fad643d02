"""The assembled telescope: parameters, components, optics, design plant."""
