MODULE MainModule
	PROC main()
		! no motion
		WaitTime 1;
	ENDPROC
ENDMODULE
