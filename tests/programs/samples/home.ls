/PROG  HOME
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "Home";
PROG_SIZE	= 1204;
CREATE		= DATE 21-07-15  TIME 10:11:12;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:J P[1] 20% FINE    ;
   2:J P[2:"Track"] 20% FINE ACC50    ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,	
	J1=      .000 deg,	J2=   -12.500 deg,	J3=    45.000 deg,
	J4=      .000 deg,	J5=     -.500 deg,	J6=   200.000 deg
};
P[2:"Track"]{
   GP1:
	UF : 0, UT : 1,	
	J1=    10.000 deg,	J2=   -12.500 deg,	J3=    45.000 deg,
	J4=      .000 deg,	J5=   -90.000 deg,	J6=      .000 deg,
	E1=  1200.000  mm
   GP2:
	UF : 0, UT : 1,	
	J1=   100.000  mm
};
/END
