//! What a client may say that knows no rules, for the links that mark where a message ends.

/// Of messages, whole ones and begun ones.
pub const PIECES: [&[u8]; 17] = [
    b"*ESE?",
    b"*IDN?\n",
    b"*ESE?;*SRE?\n",
    b"*SRE 48;*ESE 255",
    b"FOO",
    b";",
    b"\n",
    b"COMP:LOAD #15ab",
    b"'",
    b"COMP:DATA?",
    b"*IDN?;*ESE?",
    b"\x18",
    b"\n!\n",
    b"*OPC?",
    b"SYST:VERS?",
    b"AXIS1:VEL?;*WAI",
    b"*STB?;*ESR?;*SRE?;*ESE?;*SRE?;*ESE?;*SRE?;*ESE?;*SRE?;*ESE?;*SRE?;*ESE?;*SRE?;*ESE?;*SRE?;*ESE?",
];
