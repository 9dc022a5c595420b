/PROG  EQSTART
/ATTR
EIGENTUEMER	= MNEDITOR;
KOMMENTAR	= "Öffnen";
/APPL
/MN
   1:  !EQ EZSP1 TIN AUF ;
   2:L P[1] 200mm/sek CNT0 ACC100    ;
   3:L P[2] 200mm/sek CNT0    ;
/POS
P[1]{
   GP1:
	UF : F, UT : F,		KONFIG : 'N D B, 0, 0, 0',
	X = ********  mm,	Y = ********  mm,	Z = ********  mm,
	W = ******** deg,	P = ******** deg,	R = ******** deg
};
P[2]{
   GP1:
	UF : 2, UT : 5,		KONFIG : 'N U T, 0, 0, 0',
	X =   600.000  mm,	Y =   -12.125  mm,	Z =    45.500  mm,
	W =    12.000 deg,	P =   -34.000 deg,	R =    56.000 deg
};
/END
